"""Reads checkpoints as their authors published them; no code in one is ever run.

Everything goes through torch's unpickler that builds nothing but tensors, containers and numbers
(`weights_only=True`). Older training scripts also stored their scheduler or numpy numbers; the
converter knows these by name and puts something inert in their place. Any other name is refused.
"""

import pickle
import re
import struct
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import safetensors
import safetensors.torch
import torch
from torch import Tensor

from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.training_state import STAND_INS

PREFIXES: Final = ("module.", "model.")
"""Of every name, when the network was wrapped for several GPUs (SalsaNext, LMNet) or by Lightning
(FlowStep3D)."""

PLACES: Final = ("state_dict", "model_state_dict")
"""Where in a checkpoint the parameters are: SalsaNext, LMNet, GndNet, FlowStep3D; DeLORA."""

_NAMED_GLOBAL: Final = re.compile(r"GLOBAL (\S+) was not an allowed|unsupported GLOBAL (\S+) whose")

_DAMAGED: Final = (
    AttributeError,
    EOFError,
    IndexError,
    KeyError,
    OverflowError,
    RuntimeError,
    TypeError,
    ValueError,
    AssertionError,
    pickle.UnpicklingError,
    struct.error,
    zipfile.BadZipFile,
)
"""What torch raises, beside its own, on bytes that are no checkpoint."""


def read_checkpoint(path: Path, *, convert: bool = False) -> dict[str, Tensor]:
    """Read the parameters of a published checkpoint.

    Args:
        path: A file that `torch.save` wrote (.pth, .pt, .ckpt, .tar, or none), or safetensors.
        convert: Accept the training state of older scripts, and leave it out.

    Returns:
        Parameters by name without prefix, on the CPU, in the order of the file.

    Raises:
        WeightsUnusableError: If the file cannot be read, is damaged, holds code, or no parameters.
    """
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except OSError as error:
        raise WeightsUnusableError(
            f"cannot read the checkpoint: {error.strerror or error} ({path})"
        ) from error
    if path.suffix == ".safetensors":
        return without_prefix(_read_safetensors(path))
    if not start.startswith((b"PK", b"\x80")):
        raise WeightsUnusableError(f"this is no checkpoint that torch has written ({path})")
    return without_prefix(_parameters(_load(path, convert=convert), path))


def _read_safetensors(path: Path) -> dict[str, Tensor]:
    try:
        tensors: dict[str, Tensor] = safetensors.torch.load(path.read_bytes())
    except safetensors.SafetensorError as error:
        raise WeightsUnusableError(f"the checkpoint is damaged: {error} ({path})") from error
    return tensors


def _load(path: Path, *, convert: bool) -> Any:
    try:
        if zipfile.is_zipfile(path) and _is_program(path):
            raise WeightsUnusableError(f"this is a TorchScript program, not a checkpoint ({path})")
        with (
            torch.serialization.safe_globals(list(STAND_INS) if convert else []),
            warnings.catch_warnings(action="ignore"),
        ):
            return torch.load(path, map_location="cpu", weights_only=True)
    except _DAMAGED as error:
        named = _NAMED_GLOBAL.search(str(error))
        if named is None:
            raise WeightsUnusableError(
                f"the checkpoint is damaged or no checkpoint: {_first_sentence(error)} ({path})"
            ) from error
        name = named[1] or named[2]
        known = any(name == full.removeprefix("builtins.") for _, full in STAND_INS)
        advice = (
            "convert it with counterpoint weights import"
            if known
            else "only parameters, and the training state of known scripts, are taken"
        )
        raise WeightsUnusableError(
            f"the checkpoint wants to run {name}, which was refused and not run; {advice} ({path})"
        ) from error


def _is_program(path: Path) -> bool:
    with zipfile.ZipFile(path) as archive:
        return any(name.endswith("/constants.pkl") for name in archive.namelist())


def _first_sentence(error: BaseException) -> str:
    """Say what torch found; its advice would have the reader turn protection off."""
    text = str(error).rpartition("WeightsUnpickler error: ")[2]
    return (text.strip().splitlines() or [type(error).__name__])[0].split(". ")[0] or type(
        error
    ).__name__


def _parameters(document: Any, path: Path) -> dict[str, Tensor]:
    """Find the parameters in what was read."""
    if isinstance(document, Mapping):
        for place in PLACES:
            if place in document:
                document = document[place]
                break
    if not isinstance(document, Mapping) or not document:
        raise WeightsUnusableError(
            f"the checkpoint holds no parameters but {type(document).__name__}; a mapping of names "
            f"to tensors is needed, alone or under {' or '.join(PLACES)} ({path})"
        )
    for name, value in document.items():
        if not isinstance(name, str) or not isinstance(value, Tensor):
            raise WeightsUnusableError(
                f"the checkpoint holds no parameters: {str(name)[:60]!r} is no tensor but "
                f"{type(value).__name__}; they are looked for under {' and '.join(PLACES)} ({path})"
            )
    return dict(document)


def without_prefix(parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Take prefixes off the names, each only if every name has it."""
    named = dict(parameters)
    while prefix := next(
        (prefix for prefix in PREFIXES if all(name.startswith(prefix) for name in named)), None
    ):
        named = {name.removeprefix(prefix): value for name, value in named.items()}
    return named
