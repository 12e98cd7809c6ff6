"""Runtimes of exported networks, ONNX, TorchScript or torch.export, on one core."""

import hashlib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from workers.checkpoints.archives import check_archive
from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.model_files import open_regular
from workers.supervised.exported_files import check_exported, pickles_hold_tensors_alone
from workers.supervised.onnx_files import check_onnx

Run = Callable[[NDArray[np.float32]], NDArray[Any]]
"""A network: one array in, one array out."""


def open_network(path: Path, *, output: str = "") -> tuple[Run, "hashlib._Hash"]:
    """Open an exported network after a check of its files.

    Args:
        path: `.onnx`, `.pt` (TorchScript) or `.pt2` (torch.export). The last two are programs: open
            them from people you trust.
        output: Name of the output to use: of an ONNX file, or the key of a dictionary that a torch
            network returns; empty if there is only one.

    Returns:
        The network, and the sha256 of all its files.

    Raises:
        WeightsUnusableError: If a file cannot be read, is not regular, too large, or outside the
            network's folder. Also if its kind differs from its suffix, or the network does not have
            exactly one input and the named output.
    """
    try:
        checks, opens = _KINDS[path.suffix]
    except KeyError:
        known = ", ".join(_KINDS)
        raise WeightsUnusableError(
            f"a network's file ends in one of {known}, not in {path.suffix!r} ({path})"
        ) from None
    beside = checks(path)
    stored = hashlib.sha256()
    for one in (path, *beside):
        with open_regular(one, what="the network") as file:
            while chunk := file.read(_CHUNK):
                stored.update(chunk)
    return opens(path, output), stored


_CHUNK: Final = 1 << 20


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


def _check_torchscript(path: Path) -> tuple[Path, ...]:
    with open_regular(path, what="the network") as file:
        names = {member.name for member in check_archive(file, source=path)}
    if "data.pkl" in names and "constants.pkl" not in names:
        raise WeightsUnusableError(
            "the file holds parameters alone (a state dict, as torch.save writes it) and not the "
            "network: save torch.jit.trace(network, example) or torch.onnx.export it; a published "
            f"checkpoint is taken by `counterpoint weights import` ({path})"
        )
    return ()


def _open_torchscript(path: Path, output: str) -> Run:
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


def _check_exported(path: Path) -> tuple[Path, ...]:
    with open_regular(path, what="the network") as file:
        check_exported(check_archive(file, source=path), source=path)
    return ()


def _open_exported(path: Path, output: str) -> Run:
    try:
        with pickles_hold_tensors_alone():
            module = torch.export.load(path).module()
    except Exception as error:  # any of its many readers may find it damaged
        raise WeightsUnusableError(
            f"not a network of torch.export: {_first_line(error)} ({path})"
        ) from error
    return _explained(_run_torch(module, output, path), path)


_KINDS: Final[dict[str, tuple[Callable[[Path], tuple[Path, ...]], Callable[[Path, str], Run]]]] = {
    ".onnx": (check_onnx, _open_onnx),
    ".pt": (_check_torchscript, _open_torchscript),
    ".pt2": (_check_exported, _open_exported),
}
"""Check and open functions by suffix; the check returns the additional files of the network."""


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
    """Add the name of the file to errors of a network."""

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
