"""Validation of zip archives that torch writes, before torch opens them.

An archive's own table of contents is read within bounds: the decompressed size of its members, and
that every reader sees the same table. Tensors must be uncompressed; only code and names may be
compressed.
"""

import re
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import BinaryIO, Final

from workers.checkpoints.errors import WeightsUnusableError
from workers.checkpoints.model_files import MAX_STRUCTURE_BYTES
from workers.checkpoints.pickles import MAX_PICKLE_BYTES

MAX_CONTENTS_BYTES: Final = 4 << 20
"""Largest table of contents, bytes: some 40,000 members, one per tensor; networks have hundreds."""

_NUMBERS: Final = re.compile(r"(weight_|tensor_)?\d+", re.ASCII)
"""Last part of the name of a member that contains a tensor's bytes."""

_PICKLE: Final = re.compile(r".*(\.|_)pkl", re.ASCII)


@dataclass(frozen=True, slots=True)
class Member:
    """A member of a validated archive.

    Attributes:
        name: Path inside the archive's one folder, in lower case, as torch looks it up.
        read: Decompresses it within the validated bounds.
    """

    name: str
    read: Callable[[], bytes]


def check_archive(file: BinaryIO, *, source: object) -> tuple[Member, ...]:
    """Validate an archive that torch wrote.

    Args:
        file: The archive; its members can be read while it is open.
        source: Its name in messages.

    Returns:
        Its members, in the order of its table of contents.

    Raises:
        WeightsUnusableError: If it is no such archive, is damaged, or too large when decompressed.
    """
    try:
        size = _check_end(file)
        archive = zipfile.ZipFile(file)
        infos = archive.infolist()
    except (zipfile.BadZipFile, ValueError, OSError, struct.error, NotImplementedError) as error:
        raise WeightsUnusableError(
            f"no whole archive that torch has written: {str(error) or 'damaged'} ({source})"
        ) from error
    _check_sizes(infos, size, source)
    return tuple(
        Member(info.filename.partition("/")[2].lower(), _reader(archive, info, source))
        for info in infos
    )


def _check_end(file: BinaryIO) -> int:
    """Check that the only table of contents is right before the end; return the size."""
    size = file.seek(0, 2)
    file.seek(max(0, size - 98))
    tail = file.read()
    file.seek(0)
    at, end = len(tail) - 22, tail[-22:]
    if len(end) < 22 or end[:4] != b"PK\5\6" or end[20:] != b"\0\0":
        raise ValueError("its end is missing")
    entries, length, offset = struct.unpack("<HLL", end[10:20])
    if tail[at - 20 : at - 16] == b"PK\6\7":
        at -= 76
        if tail[at : at + 4] != b"PK\6\6" or struct.unpack("<Q", tail[at + 64 : at + 72])[0] != (
            size - 98
        ):
            raise ValueError("its end is damaged")
        entries, length, offset = struct.unpack("<QQQ", tail[at + 32 : at + 56])
    if offset + length != size - len(tail) + at:
        raise ValueError("its table of contents lies elsewhere")
    if length > MAX_CONTENTS_BYTES or not entries:
        raise ValueError(f"its table of contents has {length:,} bytes for {entries:,} members")
    return size


def _check_sizes(infos: list[zipfile.ZipInfo], size: int, source: object) -> None:
    total = structure = 0
    for info in infos:
        name = info.filename.rpartition("/")[2].lower()
        is_stored = info.compress_type == zipfile.ZIP_STORED
        total += info.file_size
        if _NUMBERS.fullmatch(name) or name.endswith(".pt"):
            if not is_stored:
                raise WeightsUnusableError(
                    f"the archive holds compressed tensors, which torch never writes ({source})"
                )
            continue
        structure += info.file_size
        if _PICKLE.fullmatch(name) and info.file_size > MAX_PICKLE_BYTES:
            raise WeightsUnusableError(
                f"a pickle in the archive has {info.file_size:,} bytes, and at most "
                f"{MAX_PICKLE_BYTES:,} are read ({source})"
            )
    if structure > MAX_STRUCTURE_BYTES:
        raise WeightsUnusableError(
            f"code and names in the archive have {structure:,} bytes, and at most "
            f"{MAX_STRUCTURE_BYTES:,} are read ({source})"
        )
    if total > size + MAX_STRUCTURE_BYTES:
        raise WeightsUnusableError(
            f"the archive of {size:,} bytes says that {total:,} are in it ({source})"
        )


def _reader(archive: zipfile.ZipFile, info: zipfile.ZipInfo, source: object) -> Callable[[], bytes]:
    def read() -> bytes:
        try:
            with archive.open(info) as member:
                return member.read(info.file_size)
        except Exception as error:  # zlib's and zipfile's have no common class
            raise WeightsUnusableError(
                f"{info.filename[:100]} in the archive is damaged: {error} ({source})"
            ) from error

    return read
