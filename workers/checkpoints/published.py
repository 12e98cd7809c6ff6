"""Reader of published checkpoints; it never runs their code.

Names and sizes are checked first. Then torch's unpickler builds nothing but tensors, containers and
numbers (`weights_only=True`). Older training scripts also stored their scheduler or numpy numbers;
the converter replaces these by inert objects, by name. Any other name is refused.
"""

import io
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

from workers.checkpoints.archives import check_archive
from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.model_files import read_regular
from workers.checkpoints.pickles import check_legacy, check_pickle, refused_name
from workers.checkpoints.training_state import STAND_INS

PREFIXES: Final = ("module.", "model.")
"""Prefixes of every name, from a wrapper for several GPUs (SalsaNext, LMNet) or from Lightning
(FlowStep3D)."""

PLACES: Final = ("state_dict", "model_state_dict")
"""Keys of the parameters in a checkpoint: SalsaNext, LMNet, GndNet, FlowStep3D; DeLORA."""

_NAMED_GLOBAL: Final = re.compile(r"GLOBAL (\S+) was not an allowed|unsupported GLOBAL (\S+) whose")

_DAMAGED: Final = (
    AttributeError,
    EOFError,
    IndexError,
    KeyError,
    MemoryError,
    OverflowError,
    RuntimeError,
    TypeError,
    ValueError,
    AssertionError,
    pickle.UnpicklingError,
    struct.error,
    zipfile.BadZipFile,
)
"""Exceptions of torch, in addition to its own, on bytes that are no checkpoint."""

MAX_HEADER_BYTES: Final = 4 << 20
"""Largest header of a safetensors file, bytes: names and shapes; the shipped ones have 30 KiB."""

_ARCHIVE: Final = b"PK\3\4"
_PICKLE: Final = b"\x80"


def read_checkpoint(path: Path, *, convert: bool = False) -> dict[str, Tensor]:
    """Read the parameters of a published checkpoint.

    Args:
        path: A file that `torch.save` wrote (.pth, .pt, .ckpt, .tar, or none), or safetensors.
        convert: Accept the training state of older scripts, and drop it.

    Returns:
        Parameters by name without prefix, on the CPU, in the order of the file.

    Raises:
        WeightsUnusableError: If the file cannot be read, is damaged, contains code, or no
            parameters.
    """
    data = read_regular(path, what="the checkpoint")
    if path.suffix == ".safetensors":
        return without_prefix(read_safetensors(data, what="the checkpoint is", path=path))
    if not data.startswith((_ARCHIVE, _PICKLE)):
        raise WeightsUnusableError(f"this is no checkpoint that torch has written ({path})")
    return without_prefix(_parameters(_load(data, path, convert=convert), path))


def read_safetensors(data: bytes, *, what: str, path: Path) -> dict[str, Tensor]:
    """Read tensors from the bytes of a safetensors file, with a bounded header.

    Args:
        data: The whole file.
        what: Its name in messages, with the verb: "weights are".
        path: Its path, for messages.

    Raises:
        WeightsUnusableError: If it is damaged, or has no valid header.
    """
    length = int.from_bytes(data[:8], "little")
    if length > MAX_HEADER_BYTES:
        raise WeightsUnusableError(
            f"{what} damaged: a header of {length:,} bytes, and at most {MAX_HEADER_BYTES:,} are "
            f"read ({path})"
        )
    try:
        tensors: dict[str, Tensor] = safetensors.torch.load(data)
    except (safetensors.SafetensorError, *_DAMAGED) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise WeightsUnusableError(f"{what} damaged: {reason} ({path})") from error
    return tensors


def _load(data: bytes, path: Path, *, convert: bool) -> Any:
    if data.startswith(_ARCHIVE):
        members = check_archive(io.BytesIO(data), source=path)
        if any(member.name == "constants.pkl" for member in members):
            raise WeightsUnusableError(f"this is a TorchScript program, not a checkpoint ({path})")
        for member in members:
            if member.name == "data.pkl":
                check_pickle(member.read(), convert=convert, source=path)
    else:
        check_legacy(data, convert=convert, source=path)
    try:
        with (
            torch.serialization.safe_globals(list(STAND_INS) if convert else []),
            warnings.catch_warnings(action="ignore"),
        ):
            # From memory: the checked bytes are the ones read, and torch tries no tar archive.
            return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except _DAMAGED as error:
        named = _NAMED_GLOBAL.search(str(error))
        if named is not None:
            raise refused_name(named[1] or named[2], is_known=False, source=path) from error
        raise WeightsUnusableError(
            f"the checkpoint is damaged or no checkpoint: {_first_sentence(error)} ({path})"
        ) from error


def _first_sentence(error: BaseException) -> str:
    """Return torch's finding without its advice, which would turn protection off."""
    text = str(error).rpartition("WeightsUnpickler error: ")[2]
    return (text.strip().splitlines() or [type(error).__name__])[0].split(". ")[0] or type(
        error
    ).__name__


def _parameters(document: Any, path: Path) -> dict[str, Tensor]:
    """Find the parameters in a loaded document."""
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
    """Remove prefixes from the names, each only if every name has it."""
    named = dict(parameters)
    while prefix := next(
        (prefix for prefix in PREFIXES if all(name.startswith(prefix) for name in named)), None
    ):
        named = {name.removeprefix(prefix): value for name, value in named.items()}
    return named
