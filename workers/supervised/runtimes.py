"""Networks that their owner exported, ONNX, TorchScript or torch.export, run on one core."""

import re
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from workers.checkpoints.errors import WeightsUnusableError

Run = Callable[[NDArray[np.float32]], NDArray[Any]]
"""A network: one array in, one array out."""


def open_network(path: Path, *, output: str = "") -> tuple[Run, bytes]:
    """Open an exported network.

    Args:
        path: `.onnx`, `.pt` (TorchScript) or `.pt2` (torch.export). The last two are programs: open
            them from people you trust.
        output: Name of an ONNX file's output that counts, or the key of a dictionary that a torch
            network returns; empty if there is only one.

    Returns:
        The network, and all bytes that it is stored in.

    Raises:
        WeightsUnusableError: If the file cannot be read, is of another kind than its suffix says,
            or has not one input and the named output.
    """
    try:
        opens = _OPENERS[path.suffix]
    except KeyError:
        known = ", ".join(_OPENERS)
        raise WeightsUnusableError(
            f"a network's file ends in one of {known}, not in {path.suffix!r} ({path})"
        ) from None
    if not path.is_file():
        raise WeightsUnusableError(f"no such file: the adapter's network must lie there ({path})")
    stored = _stored_bytes(path)
    return opens(path, output), stored


def _stored_bytes(path: Path) -> bytes:
    """Return the file's bytes, and those that an ONNX file keeps in files beside it."""
    stored = path.read_bytes()
    if path.suffix != ".onnx":
        return stored
    names = {
        stored[found.end() : found.end() + found[1][0]].decode(errors="replace")
        for found in _EXTERNAL.finditer(stored)
    }
    for name in sorted(names):
        try:
            stored += (path.parent / name).read_bytes()
        except OSError as error:
            raise WeightsUnusableError(
                f"the network keeps its weights in {name}: that file must lie beside it ({path})"
            ) from error
    return stored


_EXTERNAL: Final = re.compile(rb"\x0a\x08location\x12([\x01-\x7f])")
"""Before the name of a file in ONNX's protobuf: the key `location`, then the length of the name."""


def _open_onnx(path: Path, output: str) -> Run:
    try:
        import onnxruntime
    except ImportError:
        raise WeightsUnusableError(
            f"an ONNX network needs onnxruntime: pip install 'counterpoint[onnx]' ({path})"
        ) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1  # a worker owns one core
    options.use_deterministic_compute = True
    options.log_severity_level = 3
    try:
        session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its errors have no common class but this
        raise WeightsUnusableError(f"not an ONNX network: {_first_line(error)} ({path})") from error
    inputs = [given.name for given in session.get_inputs()]
    if len(inputs) != 1 or session.get_inputs()[0].type != "tensor(float)":
        given = ", ".join(f"{one.name}: {one.type}{one.shape}" for one in session.get_inputs())
        raise WeightsUnusableError(f"a network has one input of float32, not {given} ({path})")
    outputs = [one.name for one in session.get_outputs()]
    chosen = _chosen(outputs, output, path)

    def run(array: NDArray[np.float32]) -> NDArray[Any]:
        answer: NDArray[Any] = session.run([chosen], {inputs[0]: array})[0]
        return answer

    return _explained(run, path)


def _open_torchscript(path: Path, output: str) -> Run:
    if _is_state_dict(path):
        raise WeightsUnusableError(
            "the file holds parameters alone (a state dict, as torch.save writes it) and not the "
            "network: save torch.jit.trace(network, example) or torch.onnx.export it; a published "
            f"checkpoint is taken by `counterpoint weights import` ({path})"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # users still have such files
            module = torch.jit.load(str(path), map_location="cpu").eval()  # type: ignore[no-untyped-call]
    except (RuntimeError, ValueError) as error:
        raise WeightsUnusableError(
            f"not a TorchScript network: {_first_line(error)}; weights alone are not enough, save "
            f"them with torch.jit.save ({path})"
        ) from error
    return _explained(_run_torch(module, output, path), path)


def _is_state_dict(path: Path) -> bool:
    """Whether torch saved an object there, but no program that runs it; nothing is unpickled."""
    if not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        names = {name.rpartition("/")[2] for name in archive.namelist()}
    return "data.pkl" in names and "constants.pkl" not in names


def _open_exported(path: Path, output: str) -> Run:
    if not zipfile.is_zipfile(path):
        raise WeightsUnusableError(f"not a network of torch.export: no archive ({path})")
    try:
        module = torch.export.load(path).module()
    except (RuntimeError, ValueError, OSError, KeyError) as error:
        raise WeightsUnusableError(
            f"not a network of torch.export: {_first_line(error)} ({path})"
        ) from error
    return _explained(_run_torch(module, output, path), path)


_OPENERS: Final[dict[str, Callable[[Path, str], Run]]] = {
    ".onnx": _open_onnx,
    ".pt": _open_torchscript,
    ".pt2": _open_exported,
}


def _run_torch(module: torch.nn.Module, output: str, path: Path) -> Run:
    def run(array: NDArray[np.float32]) -> NDArray[Any]:
        with torch.inference_mode():
            answer = module(torch.from_numpy(array))
        if isinstance(answer, dict):
            answer = answer[_chosen(list(answer), output, path)]
        if isinstance(answer, (tuple, list)):
            _chosen([str(number) for number in range(len(answer))], output, path)
            answer = answer[int(output or "0")]
        result: NDArray[Any] = answer.contiguous().numpy()
        return result

    return run


def _chosen(outputs: list[str], output: str, path: Path) -> str:
    if output in outputs or (not output and len(outputs) == 1):
        return output or outputs[0]
    told = f"has no output {output!r}" if output else "has several outputs"
    raise WeightsUnusableError(
        f"the network {told}: name one of {', '.join(outputs)} as its output ({path})"
    )


def _explained(run: Run, path: Path) -> Run:
    """Say of which file a network's own error comes."""

    def explained(array: NDArray[np.float32]) -> NDArray[Any]:
        try:
            return run(array)
        except WeightsUnusableError:
            raise
        except Exception as error:  # any code may be in a network
            raise WeightsUnusableError(
                f"the network fails on an input of {array.shape}: {_first_line(error)} ({path})"
            ) from error

    return explained


def _first_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0][:300] if lines else type(error).__name__
