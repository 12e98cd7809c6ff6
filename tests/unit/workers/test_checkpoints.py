import io
import pickle
import subprocess
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from workers.checkpoints.errors import UnfitWeightsError, WeightsUnusableError
from workers.checkpoints.parameter_loading import load_into
from workers.checkpoints.published import read_checkpoint, without_prefix


def _net() -> nn.Sequential:
    torch.manual_seed(1)
    return nn.Sequential(nn.Conv2d(2, 3, 1), nn.BatchNorm2d(3), nn.Linear(3, 2))


def _prefixed(prefix: str) -> "OrderedDict[str, Tensor]":
    return OrderedDict((prefix + name, value) for name, value in _net().state_dict().items())


def _same(found: dict[str, Tensor]) -> bool:
    expected = _net().state_dict()
    return list(found) == list(expected) and all(
        bool((found[name] == value).all()) for name, value in expected.items()
    )


@pytest.mark.parametrize("prefix", ["", "module.", "model.", "model.module."])
@pytest.mark.parametrize("place", ["state_dict", "model_state_dict", None])
@pytest.mark.parametrize("zipped", [True, False])
def test_parameters_are_found_wherever_they_were_published(
    tmp_path: Path, prefix: str, place: str | None, zipped: bool
) -> None:
    document: Any = _prefixed(prefix)
    if place is not None:
        document = {"epoch": 3, "optimizer": {"state": {}}, "info": {"iou": 0.5}, place: document}
    torch.save(document, tmp_path / "checkpoint", _use_new_zipfile_serialization=zipped)
    assert _same(read_checkpoint(tmp_path / "checkpoint"))


def test_a_prefix_that_not_every_name_has_is_a_name() -> None:
    names = {"module.0.weight": torch.ones(1), "1.weight": torch.ones(1)}
    assert list(without_prefix(names)) == list(names)


class _Harmful:
    """Creates a file when it is unpickled."""

    def __init__(self, path: Path, how: Callable[..., Any]) -> None:
        self.path, self.how = path, how

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        if self.how is exec:
            return exec, (f"open({str(self.path)!r}, 'w').close()",)
        if self.how is subprocess.check_call:
            return subprocess.check_call, (["touch", str(self.path)],)
        return self.how, (str(self.path),)


@pytest.mark.parametrize("convert", [False, True])
@pytest.mark.parametrize("zipped", [True, False])
@pytest.mark.parametrize(
    ("how", "named"),
    [(exec, "exec"), (subprocess.check_call, "commands.check_call"), (Path.touch, "pathlib.Path")],
)
def test_code_in_a_checkpoint_is_refused_by_name_and_not_run(
    tmp_path: Path, how: Callable[..., Any], named: str, zipped: bool, convert: bool
) -> None:
    trace = tmp_path / "was-run"
    document = {"state_dict": _prefixed(""), "info": _Harmful(trace, how)}
    torch.save(document, tmp_path / "bad.pth", _use_new_zipfile_serialization=zipped)
    with pytest.raises(WeightsUnusableError) as refused:
        read_checkpoint(tmp_path / "bad.pth", convert=convert)
    assert not trace.exists()
    if (
        convert or how is not Path.touch
    ):  # bound methods of training state are known, those of paths not
        assert f"wants to run {named}, which was refused and not run" in str(refused.value)
    assert "\n" not in str(refused.value)
    pickle.loads(pickle.dumps(_Harmful(trace, exec)))  # noqa: S301  # it would have run
    assert trace.exists()


@pytest.mark.parametrize("protocol", [0, 2, 4])
def test_a_bare_pickle_with_code_in_it_is_refused_and_not_run(
    tmp_path: Path, protocol: int
) -> None:
    trace = tmp_path / "was-run"
    (tmp_path / "bad.pkl").write_bytes(pickle.dumps(_Harmful(trace, exec), protocol=protocol))
    with pytest.raises(WeightsUnusableError, match=r"bad\.pkl"):
        read_checkpoint(tmp_path / "bad.pkl", convert=True)
    assert not trace.exists()


def _old_training_state() -> dict[str, Any]:
    """What the scripts of SalsaNext and LiDAR-MOS store: a schedule as it is, numpy scores."""
    net = _net()
    optimizer = torch.optim.SGD(net.parameters(), lr=0.1, momentum=0.9)
    net(torch.ones(1, 2, 3, 3)).sum().backward()
    optimizer.step()
    schedule = torch.optim.lr_scheduler.StepLR(optimizer, 1)
    return {
        "epoch": 5,
        "state_dict": _prefixed("module."),
        "optimizer": optimizer.state_dict(),
        "info": {"best": np.float64(0.5), "history": np.arange(3.0)},
        "scheduler": {"initial_scheduler": schedule, "step": schedule.get_last_lr},
    }


@pytest.mark.parametrize("zipped", [True, False])
def test_the_training_state_of_old_scripts_is_left_out_only_by_the_converter(
    tmp_path: Path, zipped: bool
) -> None:
    path = tmp_path / "SalsaNext_valid_best"
    torch.save(_old_training_state(), path, _use_new_zipfile_serialization=zipped)
    with pytest.raises(WeightsUnusableError, match="convert it with counterpoint weights import"):
        read_checkpoint(path)
    assert _same(read_checkpoint(path, convert=True))
    with pytest.raises(WeightsUnusableError):  # nothing stays allowed
        read_checkpoint(path)


def test_whatever_is_cut_off_or_overwritten_is_one_clear_sentence(tmp_path: Path) -> None:
    path = tmp_path / "net.pth"
    for zipped in (True, False):
        buffer = io.BytesIO()
        torch.save(_prefixed(""), buffer, _use_new_zipfile_serialization=zipped)
        whole = buffer.getvalue()
        rng = np.random.default_rng(1)
        for cut in rng.integers(0, len(whole) - 8, size=25):
            path.write_bytes(whole[:cut])
            with pytest.raises(WeightsUnusableError, match=r"\(.*net\.pth\)$") as refused:
                read_checkpoint(path, convert=True)
            assert "\n" not in str(refused.value)
        for at in rng.integers(0, len(whole) - 40, size=40):
            path.write_bytes(whole[:at] + rng.bytes(40) + whole[at + 40 :])
            assert "\n" not in _refusal(path)


def _refusal(path: Path) -> str:
    """Why the file is refused; empty when the bytes that were overwritten changed nothing."""
    try:
        load_into(_net(), read_checkpoint(path, convert=True), source=path)
    except WeightsUnusableError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("document", "says"),
    [
        pytest.param({"epoch": 3}, "'epoch' is no tensor but int", id="no parameters"),
        pytest.param({}, "no parameters but dict", id="nothing"),
        pytest.param([torch.ones(1)], "no parameters but list", id="a list"),
        pytest.param({"state_dict": {"a": {"b": torch.ones(1)}}}, "'a' is no tensor", id="nested"),
    ],
)
def test_a_file_without_parameters_says_what_it_holds(
    tmp_path: Path, document: Any, says: str
) -> None:
    torch.save(document, tmp_path / "odd.pth")
    with pytest.raises(WeightsUnusableError, match=says):
        read_checkpoint(tmp_path / "odd.pth")


def test_no_file_a_text_and_a_program_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(WeightsUnusableError, match="No such file"):
        read_checkpoint(tmp_path / "none.pth")
    for text, says in (
        ("a note", "no checkpoint that torch has written"),
        ("version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS"),
        ("<!DOCTYPE html><html>not found</html>", "a web page"),
        ("", "is empty"),
    ):
        (tmp_path / "text.pth").write_text(text)
        with pytest.raises(WeightsUnusableError, match=says):
            read_checkpoint(tmp_path / "text.pth")
    with zipfile.ZipFile(tmp_path / "program.pt", "w") as archive:
        archive.writestr("program/constants.pkl", b"")
        archive.writestr("program/data.pkl", b"")
    with pytest.raises(WeightsUnusableError, match="TorchScript program"):
        read_checkpoint(tmp_path / "program.pt")


def test_every_name_that_differs_is_known_and_the_network_stays_as_it_was() -> None:
    net = _net()
    before = {name: value.clone() for name, value in net.state_dict().items()}
    given = {name: value + 1 for name, value in before.items() if name != "1.bias"}
    with pytest.raises(UnfitWeightsError) as refused:
        load_into(net, given | {"extra": torch.ones(1), "more": torch.ones(1)}, source="x.pth")
    assert refused.value.missing == ("1.bias",)
    assert refused.value.unexpected == ("extra", "more")
    assert str(refused.value) == (
        "weights lack 1 parameter: 1.bias and hold 2 parameters that the network has not: "
        "extra, more (x.pth)"
    )
    assert all(bool((net.state_dict()[name] == value).all()) for name, value in before.items())


def test_weights_of_another_network_are_said_to_be_that() -> None:
    other = {f"encoder.{i}.weight": torch.ones(1) for i in range(9)}
    with pytest.raises(UnfitWeightsError, match=r"of another network: none of its 9 parameters"):
        load_into(_net(), other, source="x.pth")


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("0.weight", torch.full((3, 2, 1, 1), torch.nan), "0.weight are not all finite"),
        ("0.bias", torch.tensor([1, torch.inf, 0]), "0.bias are not all finite"),
        ("0.bias", torch.ones(4), r"0.bias are \(4,\), the network needs \(3,\)"),
        ("0.bias", torch.ones(3, dtype=torch.int64), "0.bias are torch.int64"),
        ("1.num_batches_tracked", torch.tensor(1.5), "num_batches_tracked are torch.float32"),
    ],
)
def test_numbers_that_no_network_can_have_are_refused(name: str, value: Tensor, says: str) -> None:
    net = _net()
    with pytest.raises(UnfitWeightsError, match=says):
        load_into(net, {**net.state_dict(), name: value}, source="x.pth")


def test_half_precision_is_widened() -> None:
    net, other = _net(), _net()
    half = {
        name: value.half() if value.is_floating_point() else value
        for name, value in other.state_dict().items()
    }
    load_into(net, half, source="x.pth")
    assert all(value.dtype != torch.float16 for value in net.state_dict().values())
