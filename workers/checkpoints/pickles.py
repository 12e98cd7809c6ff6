"""Static check of pickles before torch's unpickler runs: their size, and every name in them.

Nothing is built here. Only names that parameters need are allowed. Torch's own list is longer: it
contains `bytearray`, of which a pickle of thirty bytes builds one of ten gigabytes.
"""

import io
import pickletools
import re
import struct
import warnings
from typing import Final

from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.training_state import STAND_INS

MAX_PICKLE_BYTES: Final = 4 << 20
"""Largest pickle without its tensors' numbers, bytes: names and shapes. As objects it takes up to a
hundred times that; a checkpoint of the method, training state included, has less than 200 KiB."""

_LEGACY_PICKLES: Final = 5
"""Pickles in a file that torch wrote before it wrote archives: two numbers, the platform, the
document, and the list of tensors."""

_TAKEN: Final = re.compile(
    r"""
    collections\.(OrderedDict|Counter) | _codecs\.encode | (builtins|__builtin__)\.set
    | torch\._utils\._rebuild_(tensor(_v2)?|parameter(_with_state)?)
    | torch\.nn\.parameter\.Parameter | torch\.serialization\._get_layout
    | torch\.(cuda\.)?[A-Z][A-Za-z0-9]+Storage | torch\.storage\.(Typed|Untyped)Storage
    | torch\.(Size|device|bool|b?float\d+|u?int\d+|complex\d+)
    """,
    re.VERBOSE | re.ASCII,
)

_TRAINING_STATE: Final = frozenset(name for _, name in STAND_INS)


def check_pickle(data: bytes, *, convert: bool, source: object) -> None:
    """Check one pickle.

    Args:
        data: The pickle; bytes after it are not read.
        convert: Whether names of the training state of older scripts are allowed too.
        source: Its name in messages.

    Raises:
        WeightsUnusableError: If it is damaged, too large, or contains any other name.
    """
    _check(data, count=1, convert=convert, source=source)


def check_legacy(data: bytes, *, convert: bool, source: object) -> None:
    """Check the pickles at the start of a file that torch wrote without an archive.

    Raises:
        WeightsUnusableError: As `check_pickle`.
    """
    _check(data, count=_LEGACY_PICKLES, convert=convert, source=source)


def refused_name(name: str, *, is_known: bool, source: object) -> WeightsUnusableError:
    """Build the error about a name that is not allowed."""
    advice = (
        "convert it with counterpoint weights import"
        if is_known
        else "only parameters, and the training state of known scripts, are taken"
    )
    return WeightsUnusableError(
        f"the checkpoint wants to run {name[:100]}, which was refused and not run; {advice} "
        f"({source})"
    )


def _check(data: bytes, *, count: int, convert: bool, source: object) -> None:
    file = io.BytesIO(data[:MAX_PICKLE_BYTES])
    try:
        with warnings.catch_warnings(action="ignore"):  # of escapes in texts
            for _ in range(count):
                for opcode, argument, _ in pickletools.genops(file):
                    if opcode.name == "GLOBAL":
                        _check_name(str(argument).replace(" ", "."), convert, source)
    except (ValueError, LookupError, ArithmeticError, struct.error) as error:
        if len(data) > MAX_PICKLE_BYTES and file.tell() >= MAX_PICKLE_BYTES:
            problem = f"its pickle has more than {MAX_PICKLE_BYTES:,} bytes"
        else:
            problem = f"damaged or no checkpoint: {(str(error).splitlines() or [''])[0][:200]}"
        raise WeightsUnusableError(f"the checkpoint is refused: {problem} ({source})") from error


def _check_name(name: str, convert: bool, source: object) -> None:
    if _TAKEN.fullmatch(name) or (convert and name in _TRAINING_STATE):
        return
    plain = name.removeprefix("__builtin__.").removeprefix("builtins.")
    is_known = any(plain == known.removeprefix("builtins.") for known in _TRAINING_STATE)
    raise refused_name(plain, is_known=is_known, source=source)
