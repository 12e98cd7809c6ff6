"""Files of networks that are not what they should be: one sentence each, little memory, no code."""

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper

from tests.model_bombs import (
    BOMBS,
    archive,
    exported,
    kept_in,
    members_of,
    onnx_model,
    saved,
    traced,
)
from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.published import read_checkpoint
from workers.parts.networks import read_config
from workers.supervised.adapter import Adapter
from workers.supervised.own_model import open_own_model
from workers.supervised.runtimes import open_network
from workers.supervised.weights import load_weights

ROOT = Path(__file__).parents[3]
MOST_GROWN_MIB = 256


@pytest.fixture(scope="module")
def bombs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str]]:
    """By name: by how many MiB a process grew that opened it, and what was said."""
    folder = tmp_path_factory.mktemp("bombs")
    ran = subprocess.run(
        [sys.executable, "-m", "tests.model_bombs", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    lines = map(json.loads, ran.stdout.splitlines())
    return {name: (grown, said) for name, grown, said, _ in lines}


@pytest.mark.parametrize("name", BOMBS)
def test_a_file_that_would_grow_is_refused_in_a_sentence_and_little_memory(
    name: str, bombs: dict[str, tuple[int, str]]
) -> None:
    grown_mib, said = bombs[name]
    assert grown_mib < MOST_GROWN_MIB
    assert "(/" in said
    assert "bomb." in said
    assert "\n" not in said


def _as_network(path: Path) -> object:
    return open_network(path)


def _as_profile(path: Path) -> object:
    adapter = path.with_name("adapter-of-it.toml")
    adapter.write_text(
        f'name = "a"\nprofile = "{path.name}"\n[semantic]\nfile = "a.onnx"\n'
        'classes = [{name = "a", movable = true}]\n'
    )
    return Adapter.read(adapter)


def _as_card(path: Path) -> object:
    path.with_suffix(".safetensors").write_bytes(b"never read")
    return load_weights(path.with_suffix(".safetensors"))


def _as_weights(path: Path) -> object:
    shipped = ROOT / "workers" / "supervised" / "weights" / "salsanext.json"
    path.with_suffix(".json").write_bytes(shipped.read_bytes())
    return load_weights(path)


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "onnx": ("it.onnx", _as_network),
    "torchscript": ("it.pt", _as_network),
    "torch.export": ("it.pt2", _as_network),
    "checkpoint": ("it.pth", read_checkpoint),
    "safetensors": ("it.safetensors", _as_weights),
    "published safetensors": ("it.safetensors", read_checkpoint),
    "card": ("it.json", _as_card),
    "adapter": ("it.toml", Adapter.read),
    "profile": ("it.toml", _as_profile),
    "configuration": ("it.json", lambda path: read_config(str(path), "salsanext")),
}


def _linked(path: Path) -> None:
    path.symlink_to("/dev/zero")


def _large(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(3 << 30)


ODD: dict[str, tuple[Callable[[Path], object], str]] = {
    "device": (_linked, "regular file"),
    "pipe": (lambda path: os.mkfifo(path), "regular file"),
    "folder": (lambda path: path.mkdir(), "regular file"),
    "missing": (lambda path: None, "No such file"),
    "empty": (lambda path: path.write_bytes(b""), "is empty"),
    "page": (lambda path: path.write_text("\n<!DOCTYPE html>\n<html>404"), "web page"),
    "pointer": (
        lambda path: path.write_text("version https://git-lfs.github.com/spec/v1\n"),
        "Git LFS",
    ),
    "3 GiB of holes": (_large, "at most"),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("odd", ODD)
def test_what_is_no_file_of_a_network_is_said_in_a_sentence(
    odd: str, reader: str, tmp_path: Path
) -> None:
    name, reads = READERS[reader]
    make, words = ODD[odd]
    make(tmp_path / name)
    with pytest.raises(WeightsUnusableError, match=words) as refused:
        reads(tmp_path / name)
    assert name in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", ["onnx", "pt", "pt2"])
def test_a_network_that_is_cut_off_or_overwritten_is_said_in_a_sentence(
    kind: str, tmp_path: Path
) -> None:
    kept = helper.make_tensor("kept", TensorProto.FLOAT, [4], np.zeros(4).tolist())
    whole = {"onnx": lambda: onnx_model(kept), "pt": traced, "pt2": exported}[kind]()
    path = tmp_path / f"net.{kind}"
    rng = np.random.default_rng(1)
    for cut in rng.integers(0, len(whole) - 1, size=20):
        path.write_bytes(whole[:cut])
        with pytest.raises(WeightsUnusableError) as refused:
            open_network(path)
        assert "\n" not in str(refused.value)
    for at in rng.integers(0, len(whole) - 8, size=20):
        path.write_bytes(whole[:at] + rng.bytes(8) + whole[at + 8 :])
        assert "\n" not in _refusal(path)


def _refusal(path: Path) -> str:
    """Why a network is refused; empty when the bytes that were overwritten did no harm."""
    try:
        open_network(path)
    except WeightsUnusableError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("location", "words"),
    [
        ("/dev/zero", "only files beside it"),
        ("../outside.data", "only files beside it"),
        ("sub/../../outside.data", "only files beside it"),
        ("leads-out.data", "a link that leads out"),
        ("folder-out/outside.data", "a link that leads out"),
        ("pipe.data", "regular file"),
        ("sub", "regular file"),
        ("empty.data", "is empty"),
        ("holes.data", "at most"),
        ("none.data", "must lie beside it"),
        ("*/_ORT_MEM_ADDR_/*", "must lie beside it"),
        ("a\nb.data", "name of a file of weights is none"),
        ("a" * 2000, "name of a file of weights is none"),
        ("", "name of a file of weights is none"),
    ],
)
def test_weights_outside_the_folder_of_the_network_are_not_read(
    location: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "outside.data").write_bytes(bytes(16))
    folder = tmp_path / "model"
    (folder / "sub").mkdir(parents=True)
    (folder / "leads-out.data").symlink_to(tmp_path / "outside.data")
    (folder / "folder-out").symlink_to(tmp_path)
    (folder / "empty.data").touch()
    os.mkfifo(folder / "pipe.data")
    _large(folder / "holes.data")
    (folder / "net.onnx").write_bytes(onnx_model(kept_in(location)))
    with pytest.raises(WeightsUnusableError, match=words) as refused:
        open_network(folder / "net.onnx")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("location", ["a.data", "sub/a.data", "link.data", "a" * 200 + ".data"])
def test_weights_in_the_folder_of_the_network_are_read(location: str, tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "link.data").symlink_to(tmp_path / "a.data")
    for name in ("a.data", "sub/a.data", "a" * 200 + ".data"):
        (tmp_path / name).write_bytes(np.arange(4, dtype=np.float32).tobytes())
    (tmp_path / "net.onnx").write_bytes(onnx_model(kept_in(location)))
    run, _ = open_network(tmp_path / "net.onnx")
    assert run(np.zeros((1, 5, 16, 64), np.float32)).tolist() == [0, 1, 2, 3]


def _labels(path: Path, dtype: int, value: float) -> Path:
    """A network that gives this number everywhere, and its adapter."""
    shape = [1, 16, 64]
    kept = helper.make_tensor("kept", dtype, shape, [value] * (16 * 64))
    (path / "net.onnx").write_bytes(onnx_model(kept))
    adapter = path / "adapter.toml"
    adapter.write_text(
        'name = "a"\n[profile]\nname = "a"\nrows = 16\ncolumns = 64\nfov_up_deg = 3\n'
        'fov_down_deg = -25\n[semantic]\nfile = "net.onnx"\nanswer = "labels"\n'
        'classes = [{name = "a"}, {name = "b", movable = true}]\n'
    )
    return adapter


@pytest.mark.parametrize("dtype", [TensorProto.INT64, TensorProto.INT32, TensorProto.UINT8])
def test_class_numbers_of_any_integers_are_taken(dtype: int, tmp_path: Path) -> None:
    open_own_model(_labels(tmp_path, dtype, 1))


@pytest.mark.parametrize(
    ("dtype", "value", "words"),
    [
        (TensorProto.FLOAT, 1.0, "gives float32; labels are an array of integers"),
        (TensorProto.FLOAT, 0.6, "gives float32"),
        (TensorProto.FLOAT, float("nan"), "gives float32"),
        (TensorProto.DOUBLE, 1.0, "gives float64"),
        (TensorProto.BOOL, 1, "gives bool"),
        (TensorProto.STRING, b"1", "labels are an array of integers"),
        (TensorProto.INT64, -1, "gives class -1"),
        (TensorProto.INT64, 2, "gives class 2, its adapter names 2"),
        (TensorProto.INT64, 2**62, f"gives class {2**62}"),
        (TensorProto.UINT8, 255, "gives class 255"),
    ],
)
def test_class_numbers_that_are_none_are_refused_and_not_cast(
    dtype: int, value: Any, words: str, tmp_path: Path
) -> None:
    with pytest.raises(WeightsUnusableError, match=words):
        open_own_model(_labels(tmp_path, dtype, value))


def test_scores_are_floats(tmp_path: Path) -> None:
    adapter = _labels(tmp_path, TensorProto.INT64, 1)
    adapter.write_text(adapter.read_text().replace('"labels"', '"logits"'))
    with pytest.raises(WeightsUnusableError, match="gives int64; logits are an array of floats"):
        open_own_model(adapter)


class _Touches:
    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.marker,)


def test_a_pickle_in_an_archive_of_torch_export_is_never_run(tmp_path: Path) -> None:
    """Torch itself falls back to the unpickler that runs code."""
    marker, path = tmp_path / "was-run", tmp_path / "net.pt2"
    members = members_of(exported())
    touches = _Touches(marker)
    payload = {"path_name": "opaque_obj_0", "is_param": False, "use_pickle": True}
    table = json.dumps({"config": {"a": payload | {"tensor_meta": None}}}).encode()
    for more, words in (
        ({"data/sample_inputs/model.pt": saved((touches,))}, "wants to run"),
        ({"data/weights/model.pt": saved({"a": touches})}, "wants to run"),
        ({"data/SAMPLE_INPUTS/model.PT": saved((touches,))}, "wants to run"),
        ({"data/sample_inputs/model.pt": pickle.dumps(touches, protocol=2)}, "wants to run"),
        (
            {
                "data/constants/model_constants_config.json": table,
                "data/constants/opaque_obj_0": pickle.dumps(touches),
            },
            "pickled object",
        ),
        ({"data/aotinductor/model/model.so": b"\x7fELF"}, "compiled libraries"),
    ):
        path.write_bytes(archive(members | more))
        with pytest.raises(WeightsUnusableError, match=words):
            open_network(path)
        assert not marker.exists()
    path.write_bytes(archive(members))
    open_network(path)


def test_an_archive_has_one_table_of_contents_at_its_end(tmp_path: Path) -> None:
    whole = saved({"a": torch.zeros(4)})
    path = tmp_path / "net.pth"
    for data, words in (
        (whole + b"more", "end is missing"),
        (whole + whole, "lies elsewhere|end is damaged"),
        (whole[:-2] + b"\x04\x00more", "end is missing"),
        (archive(members_of(whole)), ""),
    ):
        path.write_bytes(data)
        if words:
            with pytest.raises(WeightsUnusableError, match=words):
                read_checkpoint(path)
        else:
            assert read_checkpoint(path)["a"].shape == (4,)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("rows = 16", "rows = 1000000000", "at most 1,048,576 pixels"),
        ("rows = 16", "rows = 1" + "0" * 400, "at most 1,048,576 pixels"),
        ("rows = 16", "rows = 1" + "0" * 5000, "is no TOML"),
        ("rows = 16", "rows = -1", "no pixels"),
        ("rows = 16", "rows = 16.5", "profile.rows"),
        ("columns = 64", "columns = 65537", "at most 1,048,576 pixels"),
        ("fov_up_deg = 3", "fov_up_deg = nan", "finite number"),
        ("fov_up_deg = 3", "fov_up_deg = inf", "finite number"),
        ("fov_up_deg = 3", "fov_up_deg = 3\nstds = [1, 1, 1, 1, nan]", "finite number"),
        ('{name = "a"}, ', '{name = "a"}, ' * 10_000, "at most 254"),
        ('{name = "a"}, ', '{name = "a"}, ' * 200_000, "at most 1,048,576 are read"),
        ("classes =", 'channels = ["x"' + ', "x"' * 16 + "]\nclasses =", "at most 16"),
        ("classes =", "residual = {ages_s = [1e9]}\nclasses =", "ages"),
        ("classes =", "residual = {ages_s = []}\nclasses =", "ages"),
        ("classes =", "residual = {ages_s = [nan]}\nclasses =", "ages"),
        ("classes =", "residual = {tolerance_s = inf}\nclasses =", "tolerance_s"),
        ("classes =", "classes = " + "[" * 100_000 + "\nx =", "is no TOML"),
        ('file = "net.onnx"', 'file = "net\\u0000.onnx"', "net"),
        ('name = "a"\n[p', f'name = "{"a" * 1000}"\n[p', "name: .*at most 64"),
    ],
    ids=lambda text: text[:30],
)
def test_an_adapter_with_absurd_numbers_is_refused_in_a_sentence(
    before: str, after: str, words: str, tmp_path: Path
) -> None:
    adapter = _labels(tmp_path, TensorProto.INT64, 1)
    assert before in adapter.read_text()
    adapter.write_text(adapter.read_text().replace(before, after, 1))
    with pytest.raises(WeightsUnusableError, match=words) as refused:
        open_own_model(adapter)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 2000


def test_the_many_scores_of_an_image_are_bounded(tmp_path: Path) -> None:
    adapter = _labels(tmp_path, TensorProto.INT64, 1)
    text = adapter.read_text().replace("rows = 16\ncolumns = 64", "rows = 1024\ncolumns = 1024")
    adapter.write_text(text.replace('{name = "a"}, ', '{name = "a"}, ' * 200))
    with pytest.raises(WeightsUnusableError, match="at most 67,108,864 scores"):
        open_own_model(adapter)


def test_tensors_in_attributes_and_functions_are_found_too(tmp_path: Path) -> None:
    constant = helper.make_node("Constant", [], ["kept"], value=kept_in("../a.data"))
    body = helper.make_graph(
        [constant], "body", [], [helper.make_tensor_value_info("kept", 1, [4])]
    )
    flag = helper.make_tensor("flag", TensorProto.BOOL, [1], [True])
    nested = helper.make_node("If", ["flag"], ["answer"], then_branch=body, else_branch=body)
    image = helper.make_tensor_value_info("image", 1, [1, 5, 16, 64])
    answer = helper.make_tensor_value_info("answer", 1, [4])
    graph = helper.make_graph([nested], "graph", [image], [answer], [flag])
    model = helper.make_model(graph)
    function = helper.make_function("a", "f", [], ["kept"], [constant], model.opset_import)
    other = helper.make_model(
        helper.make_graph([], "graph", [image], [image]), functions=[function]
    )
    for made in (model, other):
        onnx.save_model(made, tmp_path / "net.onnx")
        with pytest.raises(WeightsUnusableError, match="only files beside it"):
            open_network(tmp_path / "net.onnx")
