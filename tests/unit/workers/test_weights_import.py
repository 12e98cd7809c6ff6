import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from service.cli.main import main
from workers.checkpoints.errors import UnfitWeightsError, WeightsUnusableError
from workers.errors import UnknownPartError
from workers.lidar.range_image import SensorProfile
from workers.paper.weights import load_delora, load_flowstep3d, load_gndnet
from workers.parts.catalogue import names_of
from workers.parts.networks import import_weights, known_configs, read_config, read_known
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.weights import WeightsCard, load_weights

PUBLISHED = {
    "salsanext": ("salsanext-kitti360", "module.", "state_dict"),
    "lmnet": ("lmnet-kitti360-8", "module.", "state_dict"),
    "gndnet": ("gndnet-semantickitti", "", "state_dict"),
    "flowstep3d": ("flowstep3d", "model.", "state_dict"),
    "delora": ("delora-kitti", "", "model_state_dict"),
}
LOADERS: dict[str, Callable[[Path], Any]] = {
    "salsanext": load_weights,
    "lmnet": load_weights,
    "gndnet": load_gndnet,
    "flowstep3d": load_flowstep3d,
    "delora": load_delora,
}


def _published(path: Path, network: str) -> dict[str, Tensor]:
    """Write a checkpoint as its authors do, and return its parameters."""
    config, prefix, place = PUBLISHED[network]
    torch.manual_seed(1)
    net: nn.Module = read_known(config).build()
    parameters = net.state_dict()
    torch.save({"epoch": 1, place: {prefix + k: v for k, v in parameters.items()}}, path)
    return parameters


@pytest.mark.parametrize("network", names_of("network"))
def test_every_network_of_the_paper_is_imported_number_by_number(
    tmp_path: Path, network: str
) -> None:
    parameters = _published(tmp_path / "published.pth", network)
    imported = import_weights(
        tmp_path / "published.pth",
        network=network,
        config=PUBLISHED[network][0],
        out=tmp_path / "weights",
    )
    assert imported.path == tmp_path / "weights" / f"{network}.safetensors"
    assert imported.parameters == len(parameters)
    loaded = LOADERS[network](imported.path)
    assert loaded.digest == imported.digest
    assert not loaded.net.training
    found = loaded.net.state_dict()
    assert list(found) == list(parameters)
    assert all(bool((found[name] == value).all()) for name, value in parameters.items())
    assert loaded.card.training["imported_from"] == "published.pth"
    assert loaded.card.attribution
    assert loaded.card.data_license


def test_the_stream_runs_on_a_folder_of_imported_weights(tmp_path: Path) -> None:
    for network in ("salsanext", "lmnet"):
        _published(tmp_path / network, network)
        import_weights(
            tmp_path / network, network=network, config=PUBLISHED[network][0], out=tmp_path / "w"
        )
    stream = RangeImageStream.salsanext_lmnet(tmp_path / "w")
    assert stream.class_names[14] == "car"
    assert stream.version != RangeImageStream.salsanext_lmnet(SHIPPED).version
    assert stream.version == RangeImageStream.salsanext_lmnet(tmp_path / "w").version


def test_every_configuration_that_comes_along_builds_its_network() -> None:
    assert set(known_configs()) >= {config for config, _, _ in PUBLISHED.values()}
    for config in known_configs():
        card = read_known(config)
        assert read_config(config, card.network) == card
        assert sum(parameter.numel() for parameter in card.build().parameters()) > 600_000


KITTI360 = SensorProfile(
    name="kitti360",
    rows=64,
    columns=2048,
    fov_up_deg=3,
    fov_down_deg=-25,
    means=(11.27, -0.01, 0.27, -1.01, 0.30),
    stds=(9.70, 12.14, 8.48, 0.84, 0.15),
)
SEMANTIC_KITTI = replace(
    KITTI360, means=(12.12, 10.88, 0.23, -1.04, 0.21), stds=(12.32, 11.47, 6.91, 0.86, 0.16)
)


@pytest.mark.parametrize(
    ("config", "profile"),
    [
        ("salsanext-kitti360", KITTI360),
        ("lmnet-kitti360-8", KITTI360),
        ("salsanext-semantickitti", SEMANTIC_KITTI),
        ("lmnet-semantickitti-1", SEMANTIC_KITTI),
        ("lmnet-semantickitti-8", SEMANTIC_KITTI),
    ],
)
def test_range_images_are_those_that_the_published_networks_were_trained_on(
    config: str, profile: SensorProfile
) -> None:
    card = read_known(config)
    assert isinstance(card, WeightsCard)
    assert replace(card.profile, name=profile.name, clamp=False) == profile
    assert card.profile.clamp


def test_a_configuration_may_be_a_file_or_json_and_leave_out_the_network(tmp_path: Path) -> None:
    text = read_known("flowstep3d").model_dump_json(exclude={"network"})
    (tmp_path / "mine.json").write_text(text)
    for config in (text, str(tmp_path / "mine.json")):
        assert read_config(config, "flowstep3d") == read_known("flowstep3d")


@pytest.mark.parametrize(
    ("config", "says"),
    [
        pytest.param("nowhere.json", "cannot read the configuration: No such file", id="no file"),
        pytest.param("{", "the configuration is no JSON", id="no JSON"),
        pytest.param("{}", "sidecar is not valid: attribution: Field required", id="empty"),
        pytest.param("lmnet-kitti360-8", "is of lmnet, not salsanext", id="of another network"),
        pytest.param('{"network": "lmnet"}', "not valid", id="says another network"),
    ],
)
def test_a_checkpoint_without_its_configuration_is_refused(
    tmp_path: Path, config: str, says: str
) -> None:
    _published(tmp_path / "net.pth", "salsanext")
    with pytest.raises(WeightsUnusableError, match=says):
        import_weights(
            tmp_path / "net.pth", network="salsanext", config=config, out=tmp_path / "weights"
        )
    assert not (tmp_path / "weights").exists()


def test_a_checkpoint_of_another_network_or_class_count_leaves_nothing_behind(
    tmp_path: Path,
) -> None:
    _published(tmp_path / "net.pth", "lmnet")
    out = tmp_path / "weights"
    with pytest.raises(UnfitWeightsError, match=r"downCntx.conv1.weight are \(32, 13, 1, 1\)"):
        import_weights(
            tmp_path / "net.pth", network="salsanext", config="salsanext-kitti360", out=out
        )
    with pytest.raises(UnfitWeightsError, match="weights are of another network"):
        import_weights(tmp_path / "net.pth", network="delora", config="delora-kitti", out=out)
    with pytest.raises(UnknownPartError, match="known: delora, flowstep3d, gndnet"):
        import_weights(tmp_path / "net.pth", network="unet", config="{}", out=out)
    assert not out.exists()


class _Harmful:
    """Creates a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[str]]:
        return exec, (f"open({str(self.path)!r}, 'w').close()",)


def test_the_verb_imports_and_says_so_and_refuses_code_with_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parameters = _published(tmp_path / "net.ckpt", "flowstep3d")
    command = ["weights", "import", "--network", "flowstep3d", "--config", "flowstep3d", "--json"]
    good = [*command, "--out", str(tmp_path / "out"), str(tmp_path / "net.ckpt")]
    assert main(good) == 0
    row = json.loads(capsys.readouterr().out)
    assert row["parameters"] == 281
    assert Path(row["path"]).is_file()

    torch.save({"state_dict": parameters, "x": _Harmful(tmp_path / "run")}, tmp_path / "bad.ckpt")
    bad = [*command, "--out", str(tmp_path / "other"), str(tmp_path / "bad.ckpt")]
    assert main(bad) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert "error: the checkpoint wants to run exec, which was refused and not run" in said.err
    assert "Traceback" not in said.err
    assert not (tmp_path / "run").exists()

    assert main(["weights", "configs", "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [row["config"] for row in rows] == list(known_configs())


@pytest.mark.reference
def test_a_real_published_checkpoint_is_imported(reference: Path, tmp_path: Path) -> None:
    imported = import_weights(
        reference / "golden" / "networks" / "flowstep3d_movingdetect_epoch79.ckpt",
        network="flowstep3d",
        config="flowstep3d",
        out=tmp_path,
    )
    assert not imported.converted
    keys = json.loads(
        (reference / "golden" / "networks" / "flowstep3d_movingdetect_keys.json").read_text()
    )
    means = {entry["key"].removeprefix("model."): entry for entry in keys["entries"]}
    found = load_flowstep3d(imported.path).net.state_dict()
    assert set(found) == set(means)
    for name, value in found.items():
        assert list(value.shape) == means[name]["shape"]
        assert float(value.double().mean()) == pytest.approx(means[name]["mean"], abs=1e-6)


def test_an_import_without_config_names_those_that_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(tmp_path / "x"), "--network", "lmnet", "--out", str(tmp_path / "w")]
    assert main(["weights", "import", *arguments]) == 1
    said = capsys.readouterr().err
    assert "weights configs" in said
    assert "lmnet-semantickitti-1, lmnet-semantickitti-8" in said
    assert "salsanext" not in said
