"""Files of networks that grow in memory; run, it measures what each takes to be refused.

    python -m tests.model_bombs FOLDER

It prints a line of JSON for each: its name, how much the process grew in MiB, and what was said.
"""

import io
import json
import os
import pickle
import resource
import sys
import time
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import onnxruntime  # noqa: F401 -- imported before anything is measured
import torch
from onnx import TensorProto, helper
from safetensors import safe_open  # noqa: F401 -- imported before anything is measured
from torch import nn

from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.published import read_checkpoint
from workers.supervised.adapter import Adapter
from workers.supervised.runtimes import open_network
from workers.supervised.weights import load_weights

SIZE: Final = 96 << 20
"""Bytes of a bomb's part, unpacked."""

MEMORY: Final = 8 << 30
"""Address space that one may take: enough to see it, too little to harm the machine."""

ROUND: Final = "net/"


def archive(members: dict[str, bytes], *, packed: str = "") -> bytes:
    """An archive as torch writes it, but for one member that is compressed."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compresslevel=1) as opened:
        for name, data in members.items():
            kind = zipfile.ZIP_DEFLATED if name == packed else zipfile.ZIP_STORED
            opened.writestr(ROUND + name, data, kind)
    return buffer.getvalue()


def members_of(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as opened:
        return {name.partition("/")[2]: opened.read(name) for name in opened.namelist()}


def traced() -> bytes:
    buffer = io.BytesIO()
    with warnings.catch_warnings(action="ignore"):  # every exporter recommends another one
        net = torch.jit.trace(nn.Conv2d(5, 2, 1).eval(), torch.zeros(1, 5, 16, 64))  # type: ignore[no-untyped-call]
        torch.jit.save(net, buffer)
    return buffer.getvalue()


def exported() -> bytes:
    buffer = io.BytesIO()
    net, given = nn.Conv2d(5, 2, 1).eval(), (torch.zeros(1, 5, 16, 64),)
    torch.export.save(torch.export.export(net, given), buffer)
    return buffer.getvalue()


def onnx_model(*tensors: TensorProto, sparse: tuple[Any, ...] = ()) -> bytes:
    """A model that gives back its tensor."""
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 5, 16, 64])
    kind = tensors[0].data_type if tensors else TensorProto.FLOAT
    answer = helper.make_tensor_value_info("answer", kind, None)
    graph = helper.make_graph(
        [helper.make_node("Identity", ["kept"], ["answer"])],
        "graph",
        [image],
        [answer],
        list(tensors),
        sparse_initializer=list(sparse),
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    return bytes(made.SerializeToString())


def kept_in(location: str, *, elements: int = 4) -> TensorProto:
    """A tensor whose numbers lie in a file."""
    tensor = TensorProto(name="kept", data_type=TensorProto.FLOAT, dims=[elements])
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key="location", value=location)
    return tensor


class Grows:
    """Is unpickled as a gigabyte of zeros."""

    def __reduce__(self) -> tuple[Any, ...]:
        return bytearray, (1 << 30,)


def saved(document: Any) -> bytes:
    buffer = io.BytesIO()
    torch.save(document, buffer)
    return buffer.getvalue()


def sparse_tensor() -> Any:
    values = helper.make_tensor("kept", TensorProto.FLOAT, [1], [1.0])
    places = helper.make_tensor("places", TensorProto.INT64, [1], [0])
    return helper.make_sparse_tensor(values, places, [200_000_000])


def _lists() -> bytes:
    return b"\x80\x02" + b"]" * SIZE + b"."


def _zeros_onnx(path: Path) -> None:
    path.write_bytes(onnx_model(kept_in("/dev/zero")))


def _hole(path: Path) -> None:
    with path.open("wb") as file:
        file.write(b"\x08\x08")
        file.truncate(6 << 30)


def _header(path: Path) -> None:
    entry = b'{"dtype":"F32","shape":[0],"data_offsets":[0,0]}'
    header = b"{" + b",".join(b'"%d":' % n + entry for n in range(SIZE // 60)) + b"}"
    path.with_suffix(".json").write_bytes(
        (Path("workers/supervised/weights") / "salsanext.json").read_bytes()
    )
    path.write_bytes(len(header).to_bytes(8, "little") + header)


def _wide(path: Path) -> None:
    """Weights whose card asks for a network of four thousand channels."""
    shipped = Path("workers/supervised/weights")
    card = json.loads((shipped / "salsanext.json").read_text())
    path.with_suffix(".json").write_text(json.dumps(card | {"width": 1024}))
    path.write_bytes((shipped / "salsanext.safetensors").read_bytes())


def _entry(path: Path, rows: int) -> None:
    path.write_text(
        f'name = "a"\n[profile]\nname = "a"\nrows = {rows}\ncolumns = 1000000000\n'
        'fov_up_deg = 3\nfov_down_deg = -25\n[semantic]\nfile = "a.onnx"\n'
        'classes = [{name = "a", movable = true}]\n'
    )


BOMBS: Final[dict[str, tuple[str, Callable[[Path], Any], Callable[[Path], Any]]]] = {
    "external data in a device": (".onnx", _zeros_onnx, open_network),
    "a file of holes": (".onnx", _hole, open_network),
    "sparse tensor": (
        ".onnx",
        lambda path: path.write_bytes(onnx_model(sparse=(sparse_tensor(),))),
        open_network,
    ),
    "a graph of nothing but names": (
        ".onnx",
        lambda path: path.write_bytes(
            onnx_model(
                helper.make_tensor("kept", TensorProto.FLOAT, [1], [1.0]),
            )
            + b"\x72\x00" * (SIZE // 2)
        ),
        open_network,
    ),
    "packed pickle in a checkpoint": (
        ".pth",
        lambda path: path.write_bytes(
            archive(
                {**members_of(saved({"a": torch.zeros(4)})), "data.pkl": _lists()},
                packed="data.pkl",
            )
        ),
        read_checkpoint,
    ),
    "bare pickle": (".pth", lambda path: path.write_bytes(_lists()), read_checkpoint),
    "thirty bytes of pickle": (
        ".pth",
        lambda path: path.write_bytes(saved({"state_dict": {"a": Grows()}})),
        read_checkpoint,
    ),
    "thirty bytes of bare pickle": (
        ".pth",
        lambda path: path.write_bytes(pickle.dumps(Grows(), protocol=2)),
        read_checkpoint,
    ),
    "packed numbers in a checkpoint": (
        ".pth",
        lambda path: path.write_bytes(
            archive(members_of(saved({"a": torch.zeros(SIZE)})), packed="data/0")
        ),
        read_checkpoint,
    ),
    "packed numbers in TorchScript": (
        ".pt",
        lambda path: path.write_bytes(
            archive(members_of(traced()) | {"data/9": bytes(4 * SIZE)}, packed="data/9")
        ),
        open_network,
    ),
    "packed pickle in TorchScript": (
        ".pt",
        lambda path: path.write_bytes(
            archive(members_of(traced()) | {"data.pkl": _lists()}, packed="data.pkl")
        ),
        open_network,
    ),
    "packed graph in torch.export": (
        ".pt2",
        lambda path: path.write_bytes(
            archive(
                members_of(exported()) | {"models/model.json": b"[" + b"[]," * (SIZE // 3)},
                packed="models/model.json",
            )
        ),
        open_network,
    ),
    "pickle in example inputs": (
        ".pt2",
        lambda path: path.write_bytes(
            archive(members_of(exported()) | {"data/sample_inputs/model.pt": saved((Grows(),))})
        ),
        open_network,
    ),
    "header of safetensors": (".safetensors", _header, load_weights),
    "card of a wide network": (".safetensors", _wide, load_weights),
    "adapter of large images": (".toml", lambda path: _entry(path, 10**9), Adapter.read),
    "adapter without an end": (".toml", lambda path: path.symlink_to("/dev/zero"), Adapter.read),
}
"""By name: the file's suffix, what writes it, and what opens it."""


def _refused(path: Path, opens: Callable[[Path], Any]) -> str:
    try:
        opens(path)
    except WeightsUnusableError as error:
        return str(error)
    except BaseException as error:  # noqa: BLE001 -- whatever it is, the test fails
        return f"not a sentence: {type(error).__name__}"
    return "opened"


def measured(path: Path, opens: Callable[[Path], Any]) -> tuple[int, str]:
    """Open a file in a child: by how many MiB it grew at most, and what was said."""
    receives, sends = os.pipe()
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        said = _refused(path, opens)
        grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024
        os.write(sends, json.dumps([grown, said]).encode()[:4000])
        os._exit(0)
    os.close(sends)
    with os.fdopen(receives) as answer:
        told = answer.read()
    _, status, usage = os.wait4(child, 0)
    if not told:
        return usage.ru_maxrss // 1024, f"not a sentence: ended with {status}"
    grown, said = json.loads(told)
    return int(grown), str(said)


def main(folder: Path) -> None:
    """Write and measure every bomb."""
    warm = folder / "warm.pt2"
    warm.write_bytes(exported())
    open_network(warm)  # imports what is not to be measured
    for name, (suffix, write, opens) in BOMBS.items():
        path = folder / f"bomb{suffix}"
        if os.fork() == 0:  # writing one takes memory, too
            write(path)
            os._exit(0)
        _, status = os.wait()
        assert status == 0, name
        begin = time.monotonic()
        grown, said = measured(path, opens)
        took_s = round(time.monotonic() - begin, 1)
        sys.stdout.write(json.dumps([name, grown, said, took_s]) + "\n")
        sys.stdout.flush()
        path.unlink()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
