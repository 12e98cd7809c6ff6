"""A model of one's own is the stream its adapter says; what it is not is refused in a sentence."""

import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from torch import nn

from schemas.frame import PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from tests.factories import scattered
from tests.pandaset_clouds import read_clouds
from workers.checkpoints.errors import WeightsUnusableError
from workers.errors import UnknownPartError
from workers.lab.calibration.sensor_profile import profile_text
from workers.lidar.range_image import SensorProfile, project
from workers.lidar.sensor_rows import lay_out
from workers.parts.files import PartFiles
from workers.parts.registry import build_parts
from workers.supervised.networks import RangeImageNetwork
from workers.supervised.own_model import open_own_model
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.runtimes import open_network
from workers.supervised.salsanext import SalsaNext
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.weights import LoadedWeights, load_weights

SMALL = SensorProfile(
    name="small",
    rows=16,
    columns=64,
    fov_up_deg=10,
    fov_down_deg=-20,
    means=(10.0, 0.0, 0.0, -1.0, 0.5),
    stds=(10.0, 10.0, 10.0, 1.0, 0.3),
)


def _export(net: nn.Module, path: Path, *shape: int) -> None:
    """Export a network as its owner would."""
    example = torch.zeros(1, *shape)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # every exporter recommends another one
        if path.suffix == ".onnx":
            torch.onnx.export(
                net,
                (example,),
                path,
                dynamo=False,
                input_names=["given"],
                output_names=["scores"],
                dynamic_axes={"given": [1], "scores": [1]} if len(shape) == 2 else None,
            )
        elif path.suffix == ".pt":
            torch.jit.save(torch.jit.trace(net, example, check_trace=False), str(path))  # type: ignore[no-untyped-call]
        else:
            torch.export.save(torch.export.export(net, (example,)), path)


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _profile(profile: SensorProfile) -> dict[str, Any]:
    names = ("name", "rows", "columns", "fov_up_deg", "fov_down_deg", "means", "stds")
    told = {name: getattr(profile, name) for name in names}
    return told | ({"elevations_deg": profile.elevations_deg} if profile.elevations_deg else {})


def _adapter(path: Path, **entries: Any) -> Path:
    path.write_text("".join(f"{key} = {_toml(value)}\n" for key, value in entries.items()))
    return path


def _entry(network: RangeImageNetwork, file: str, **more: Any) -> dict[str, Any]:
    classes = [
        {"name": one.name, "movable": one.movable, "moving": one.moving, "ignored": one.ignored}
        for one in network.classes
    ]
    told: dict[str, Any] = {
        "file": file,
        "answer": "probabilities",
        "classes": classes,
        "channels": list(network.channels),
    }
    if isinstance(network.residual, ResidualSettings):
        told["residual"] = asdict(network.residual)
    return told | more


def _real_frames(reference: Path) -> list[PosedFrame]:
    """Two frames of a street, with their true poses."""
    name = Path("pandaset", "panda-01", "2019-05-11", "pandaset-002")
    log = reference / "data" / "logs" / name.with_suffix(".mcap")
    clouds = read_clouds(log, reference / "data" / "truth" / name, range(40, 42))
    return [PosedFrame(cloud.frame, cloud.world_from_sensor) for cloud in clouds]


def _share_equal(one: list[FrameLabels], other: list[FrameLabels]) -> float:
    pairs = zip(one, other, strict=True)
    return float(np.mean([(a.labels == b.labels).mean() for a, b in pairs]))


@pytest.fixture(scope="module")
def shipped() -> tuple[LoadedWeights, LoadedWeights]:
    return load_weights(SHIPPED / "salsanext.safetensors"), load_weights(
        SHIPPED / "lmnet.safetensors"
    )


@pytest.mark.reference
def test_parameters_alone_are_no_network_and_the_message_says_what_is(tmp_path: Path) -> None:
    path = tmp_path / "net.pt"
    torch.save(torch.nn.Linear(2, 2).state_dict(), path)
    with pytest.raises(WeightsUnusableError, match=r"parameters alone.*weights import"):
        open_network(path)


@pytest.mark.parametrize("suffix", [".onnx", ".pt", ".pt2"])
def test_our_own_networks_fed_back_as_exports_give_our_labels(
    suffix: str,
    shipped: tuple[LoadedWeights, LoadedWeights],
    reference: Path,
    tmp_path: Path,
) -> None:
    frames = _real_frames(reference)
    profile = lay_out(shipped[0].profile, frames[0].frame)
    entries = {}
    for role, network in zip(("semantic", "motion"), shipped, strict=True):
        channels = len(network.channels) + len(network.residual.ages_s if network.residual else ())
        _export(network.net, tmp_path / f"{role}{suffix}", channels, profile.rows, profile.columns)
        entries[role] = _entry(network, f"{role}{suffix}")
    adapter = _adapter(
        tmp_path / "adapter.toml",
        name="fed-back",
        profile=_profile(profile),
        **entries,
    )
    stream = open_own_model(adapter)
    ours, theirs = list(RangeImageStream.salsanext_lmnet(SHIPPED)(frames)), list(stream(frames))
    assert stream.class_names == RangeImageStream.salsanext_lmnet(SHIPPED).class_names
    assert _share_equal(ours, theirs) > 0.9999
    assert (np.concatenate([a.labels for a in ours]) == MotionLabel.DYNAMIC).sum() > 1000
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(
            a.confidence.astype(float), b.confidence.astype(float), atol=2e-3
        )
    assert all(_share_equal(theirs, list(stream(frames))) == 1.0 for _ in range(2))


class _ByHeight(nn.Module):
    """Points over the sensor are of class 1, those below of class 0."""

    def forward(self, points: torch.Tensor) -> torch.Tensor:
        """Map (1, N, C) to (1, N, 2)."""
        z = points[..., 0]
        return torch.stack((-z, z), dim=-1)


@pytest.mark.parametrize("suffix", [".onnx", ".pt"])
def test_a_network_over_points_labels_each_valid_point(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"height{suffix}"
    _export(_ByHeight(), path, 50, 1)
    adapter = _adapter(
        tmp_path / "adapter.toml",
        name="by-height",
        semantic={
            "file": path.name,
            "input": "points",
            "channels": ["z"],
            "classes": [{"name": "standing"}, {"name": "flying", "moving": True}],
        },
    )
    parts = build_parts(
        odometry="kiss-icp",
        supervised="own",
        selfsupervised="two-stage",
        files=PartFiles(model=str(adapter)),
    )
    assert parts.supervised.version.startswith("by-height@")
    (posed,) = scattered(1)
    (answer,) = parts.supervised([posed])
    z = posed.frame.points_m[:, 2]
    expected = np.where(z > 0, MotionLabel.DYNAMIC, MotionLabel.STATIC)
    expected[~posed.frame.valid_mask] = MotionLabel.UNKNOWN
    np.testing.assert_array_equal(answer.labels, expected)
    assert answer.class_id is not None
    assert (answer.class_id[~posed.frame.valid_mask] == -1).all()
    assert (answer.confidence[posed.frame.valid_mask] >= 0.5).all()


class _Fixed(nn.Module):
    """Gives the same scores everywhere."""

    def __init__(self, *scores: float) -> None:
        super().__init__()
        self.scores = nn.Parameter(torch.tensor(scores))

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Map (1, C, H, W) to (1, K, H, W)."""
        return self.scores[None, :, None, None] + 0 * image[:, :1]


def _small(tmp_path: Path, net: nn.Module, **more: Any) -> Path:
    channels = len(more.get("channels", range(5)))
    _export(net, tmp_path / "net.onnx", channels, SMALL.rows, SMALL.columns)
    classes = [{"name": "road"}, {"name": "car", "movable": True}]
    entry = {"file": "net.onnx", "classes": classes} | more
    return _adapter(
        tmp_path / "adapter.toml", name="small", profile=_profile(SMALL), semantic=entry
    )


def test_without_a_motion_network_what_can_move_is_unknown_and_all_else_static(
    tmp_path: Path,
) -> None:
    (posed,) = scattered(1)
    (cars,) = open_own_model(_small(tmp_path, _Fixed(0.0, 3.0)))([posed])
    assert set(cars.labels.tolist()) == {MotionLabel.UNKNOWN}
    (roads,) = open_own_model(_small(tmp_path, _Fixed(3.0, 0.0)))([posed])
    assert set(roads.labels.tolist()) == {MotionLabel.UNKNOWN, MotionLabel.STATIC}
    judged = roads.labels == MotionLabel.STATIC
    np.testing.assert_allclose(
        roads.confidence[judged].astype(float), 1 / (1 + np.exp(-3.0)), atol=1e-3
    )


def test_chosen_channels_and_class_numbers_are_understood(tmp_path: Path) -> None:
    class Far(nn.Module):
        def forward(self, image: torch.Tensor) -> torch.Tensor:
            return (image[:, 1] * 10 + 10 > 20).to(torch.int64)

    adapter = _small(tmp_path, Far(), channels=["intensity", "range"], answer="labels")
    (posed,) = scattered(1)
    (answer,) = open_own_model(adapter)([posed])
    assert answer.class_id is not None
    seen = project(posed.frame.points_m, SMALL, valid_mask=posed.frame.valid_mask).index
    shown = seen[seen >= 0]
    range_m = np.linalg.norm(posed.frame.points_m[shown], axis=1)
    clear = np.abs(range_m - 20) > 1  # nearer ones are voted on
    assert clear.sum() > 100
    np.testing.assert_array_equal(answer.class_id[shown][clear], (range_m > 20)[clear])


def test_what_is_in_the_model_makes_the_version_and_not_where_it_lies(tmp_path: Path) -> None:
    versions = []
    for folder, scores in (("a", (0.0, 1.0)), ("b", (0.0, 1.0)), ("c", (1.0, 0.0))):
        (tmp_path / folder).mkdir()
        versions.append(open_own_model(_small(tmp_path / folder, _Fixed(*scores))).version)
    assert versions[0] == versions[1] != versions[2]


def test_weights_that_onnx_keeps_in_a_file_of_their_own_count(tmp_path: Path) -> None:
    versions = []
    for folder, score in (("a", 1.0), ("b", 2.0)):
        (tmp_path / folder).mkdir()
        adapter = _small(tmp_path / folder, _Fixed(0.0, score))
        net = tmp_path / folder / "net.onnx"
        model = onnx.load(net)
        onnx.save(model, net, save_as_external_data=True, location="net.data", size_threshold=0)
        versions.append((open_own_model(adapter).version, net.read_bytes()))
    assert versions[0][1] == versions[1][1]
    assert versions[0][0] != versions[1][0]
    (tmp_path / "b" / "net.data").unlink()
    with pytest.raises(WeightsUnusableError, match=r"keeps its weights in net\.data"):
        open_own_model(tmp_path / "b" / "adapter.toml")


def test_a_profile_may_be_the_file_that_was_measured(tmp_path: Path) -> None:
    adapter = _small(tmp_path, _Fixed(0.0, 3.0))
    (tmp_path / "lidar.toml").write_text(profile_text(SMALL, ".toml"))
    before = open_own_model(adapter).version
    lines = adapter.read_text().splitlines()
    lines = ['profile = "lidar.toml"' if line.startswith("profile") else line for line in lines]
    adapter.write_text("\n".join(lines))
    assert open_own_model(adapter).version == before


def test_a_model_that_nobody_would_run_is_refused(tmp_path: Path) -> None:
    adapter = _small(tmp_path, _Fixed(0.0, 3.0))
    with pytest.raises(UnknownPartError, match="choose it with --supervised own"):
        build_parts(
            odometry="kiss-icp",
            supervised="salsanext-lmnet",
            selfsupervised="registration",
            files=PartFiles(model=str(adapter)),
        )


@pytest.mark.parametrize(
    ("net", "more", "words"),
    [
        (_Fixed(0.0, 1.0, 2.0), {}, r"gives \(1, 3, 16, 64\).*2 classes are \(1, 2, 16, 64\)"),
        (_Fixed(0.0, float("nan")), {}, "NaN or infinite"),
        (_Fixed(0.0, 3.0), {"answer": "probabilities"}, 'no probabilities.*answer = "logits"'),
        (_Fixed(0.0, 1.0), {"classes": [{"name": "a"}, {"name": "b"}]}, "nothing could ever"),
        (SalsaNext(in_channels=5, classes=2, width=4), {"channels": ["x"]}, "fails on an input"),
        (_Fixed(0.0, 1.0), {"output": "other"}, "no output 'other': name one of scores"),
        (_Fixed(0.0, 1.0), {"file": "absent.onnx"}, "No such file"),
        (_Fixed(0.0, 1.0), {"file": "net.pkl"}, "ends in one of"),
        (_Fixed(0.0, 1.0), {"channels": ["depth"]}, r"semantic.channels.0: Input should be"),
        (_Fixed(0.0, 1.0), {"classes": []}, "semantic.classes: .*at least 1"),
        (_Fixed(0.0, 1.0), {"colour": "red"}, "semantic.colour: Extra inputs"),
        (_Fixed(0.0, 1.0), {"input": "points", "residual": {}}, "not to points"),
    ],
)
def test_a_model_that_is_not_what_its_adapter_says_is_refused(
    net: nn.Module, more: dict[str, Any], words: str, tmp_path: Path
) -> None:
    if more.get("channels") == ["x"]:
        _export(net, tmp_path / "five.onnx", 5, SMALL.rows, SMALL.columns)
        adapter = _small(tmp_path, _Fixed(0.0, 1.0), **more)
        (tmp_path / "five.onnx").replace(tmp_path / "net.onnx")
    else:
        adapter = _small(tmp_path, net, **more)
    with pytest.raises(WeightsUnusableError, match=words):
        open_own_model(adapter)


def test_files_that_are_no_networks_are_refused_and_nothing_in_them_is_run(tmp_path: Path) -> None:
    marker = tmp_path / "was-run"
    for suffix in (".onnx", ".pt", ".pt2"):
        adapter = _small(tmp_path, _Fixed(0.0, 1.0), file=f"bad{suffix}")
        bad = tmp_path / f"bad{suffix}"
        whole = tmp_path / f"whole{suffix}"
        _export(_Fixed(0.0, 1.0), whole, 5, SMALL.rows, SMALL.columns)
        _pickled_code(tmp_path / "code", marker)
        for content in (
            b"",
            b"nonsense",
            whole.read_bytes()[:700],
            (tmp_path / "code").read_bytes(),
        ):
            bad.write_bytes(content)
            with pytest.raises(WeightsUnusableError, match=rf"bad\{suffix}"):
                open_own_model(adapter)
    assert not marker.exists()


def _pickled_code(path: Path, marker: Path) -> None:
    class Evil:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (marker,)

    torch.save({"weights": Evil()}, path)


def test_an_adapter_must_be_there_and_be_toml(tmp_path: Path) -> None:
    with pytest.raises(WeightsUnusableError, match="cannot read the adapter"):
        open_own_model(tmp_path / "adapter.toml")
    (tmp_path / "adapter.toml").write_text("name = ")
    with pytest.raises(WeightsUnusableError, match="no TOML"):
        open_own_model(tmp_path / "adapter.toml")
    with pytest.raises(WeightsUnusableError, match="name a network under"):
        open_own_model(_adapter(tmp_path / "adapter.toml", name="empty"))
