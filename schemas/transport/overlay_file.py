"""Reading of an overlay by byte ranges: its header and single blocks, without decoding points."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final
from zlib import crc32

from pydantic import ValidationError

from schemas.transport.array_pack import MAX_UNPACKED_BYTES, PackUnreadableError
from schemas.transport.overlay_blocks import decompress
from schemas.transport.overlay_header import (
    BEGIN,
    MAX_HEADER_BYTES,
    OVERLAY_MAGIC,
    Block,
    OverlayHeader,
)

NEWEST_VERSION: Final = 2
"""Newest version of overlays that this program reads."""

FIRST_BYTES: Final = 64 * 1024
"""Bytes that are read first; the header of most scenes is within them."""

ReadRange = Callable[[int, int], bytes]
"""Returns the bytes from an offset on, of a length; fewer where the file ends."""


class OverlayUnusableError(PackUnreadableError):
    """The overlay cannot be used; the message names the place and what to do."""


class OverlayTooNewError(OverlayUnusableError):
    """The overlay has a version that only a newer Counterpoint reads."""


class OverlayIsVersion1Error(OverlayUnusableError):
    """The overlay is of version 1, which has no blocks: `as_version_2` makes one that has."""


class _TooNewError(PackUnreadableError):
    """Of a newer version, before the place is known."""


class _IsVersion1Error(PackUnreadableError):
    """Of version 1, before the place is known."""


@dataclass(frozen=True, slots=True, eq=False)
class OverlayFile:
    """An overlay of version 2 of which single blocks are read.

    Attributes:
        header: Its header.
        header_json: The header as stored.
        read: Reads byte ranges of the file.
        where: URL or path of the file, for messages.
    """

    header: OverlayHeader
    header_json: bytes
    read: ReadRange
    where: str = ""

    def view(self, frame: int) -> bytes:
        """Return the view block of a frame, as stored: one zstd frame."""
        entry = self.header.frames[frame]
        return self._block(entry.view, entry.view_crc32, f"frame {frame}")

    def rest(self, frame: int) -> bytes:
        """Return the rest block of a frame, as stored: one zstd frame."""
        entry = self.header.frames[frame]
        return self._block(entry.rest, entry.rest_crc32, f"the rest of frame {frame}")

    def picture(self, number: int) -> bytes:
        """Return the image of a picture, JPEG or PNG."""
        entry = self.header.pictures[number]
        return self._block(entry.block, entry.crc32, f"picture {number}")

    def scoring_inputs(self) -> bytes:
        """Return the inputs of the score, decompressed; empty where the overlay has none."""
        block = self._block(self.header.inputs, self.header.inputs_crc32, "the inputs of the score")
        try:
            return decompress(block) if block else b""
        except PackUnreadableError as error:
            raise unusable(error, self.where) from error

    def _block(self, place: Block, crc: int, what: str) -> bytes:
        block = self.read(*place) if place[1] else b""
        if len(block) != place[1] or crc32(block) != crc:
            problem = PackUnreadableError(f"damaged: {what} does not have its checksum")
            raise unusable(problem, self.where)
        return block


def open_overlay_file(read: ReadRange, *, file_bytes: int, where: str = "") -> OverlayFile:
    """Open an overlay of which single blocks are read.

    Args:
        read: Reads byte ranges of the file.
        file_bytes: Length of the file.
        where: URL or path of the file, for messages.

    Raises:
        OverlayIsVersion1Error: If it is of version 1.
        PackUnreadableError: If it is no overlay, damaged, larger than any overlay, or of a newer
            version; the message names the place and what to do.
    """
    try:
        return _opened(read, file_bytes, where)
    except PackUnreadableError as error:
        raise unusable(error, where) from error


def unusable(problem: str | PackUnreadableError, where: str) -> OverlayUnusableError:
    """Return the error of an overlay that cannot be used: what, where, what to do."""
    place = f" ({where})" if where else ""
    if isinstance(problem, _TooNewError):
        return OverlayTooNewError(f"the overlay {problem}: update Counterpoint{place}")
    if isinstance(problem, _IsVersion1Error):
        return OverlayIsVersion1Error(f"the overlay {problem}{place}")
    words = problem if isinstance(problem, str) else f"is unreadable: {problem}"
    return OverlayUnusableError(
        f"the overlay {words}: put it back from a copy of the artifacts, or draw the log with "
        f"`counterpoint score LOG --pictures FOLDER`{place}"
    )


def version_of(first: bytes) -> int:
    """Return the version of an overlay by its first eight bytes.

    Raises:
        PackUnreadableError: If they are not those of an overlay, or of a newer version.
    """
    magic = bytes(first[: len(OVERLAY_MAGIC)])
    digit = magic[5:6]
    if not (magic[:5] == OVERLAY_MAGIC[:5] and digit.isdigit() and magic[6:] == OVERLAY_MAGIC[6:]):
        raise PackUnreadableError(f"expected {OVERLAY_MAGIC!r} at the start, found {magic!r}")
    version = int(digit)
    if version > NEWEST_VERSION:
        raise _TooNewError(f"is of version {version}, and this program reads 1 to {NEWEST_VERSION}")
    return version


def _opened(read: ReadRange, file_bytes: int, where: str) -> OverlayFile:
    if file_bytes > MAX_UNPACKED_BYTES:
        raise PackUnreadableError(f"has {file_bytes} bytes, more than {MAX_UNPACKED_BYTES}")
    first = read(0, min(FIRST_BYTES, file_bytes))
    if version_of(first) != NEWEST_VERSION:
        raise _IsVersion1Error("is of version 1, whose frames cannot be read alone")
    if len(first) < BEGIN.size:
        raise PackUnreadableError(f"damaged: {len(first)} bytes, less than the begin of a file")
    _, length, crc = BEGIN.unpack_from(first)
    end = BEGIN.size + length
    if length > MAX_HEADER_BYTES or end > file_bytes:
        raise PackUnreadableError(f"damaged: claims a header of {length} bytes in {file_bytes}")
    stored = bytes(first[BEGIN.size : end])
    if len(stored) < length:
        at = BEGIN.size + len(stored)
        stored += read(at, end - at)
    if len(stored) != length or crc32(stored) != crc:
        raise PackUnreadableError("damaged: the header does not have its checksum")
    header = _parsed(stored)
    if any(offset + size > file_bytes for offset, size in header.blocks()):
        raise PackUnreadableError(f"damaged: a block ends beyond the {file_bytes} bytes of it")
    return OverlayFile(header, stored, read, where)


def _parsed(stored: bytes) -> OverlayHeader:
    try:
        header = OverlayHeader.model_validate_json(stored)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise PackUnreadableError(f"not a well-formed overlay: {where}: {first['msg']}") from error
    columns = header.instances
    if len({len(columns.frame), len(columns.kind), len(columns.track), len(columns.boxes)}) != 1:
        raise PackUnreadableError("not a well-formed overlay: instances of different numbers")
    if any(picture.frame >= len(header.frames) for picture in header.pictures):
        raise PackUnreadableError(
            "not a well-formed overlay: a picture of a frame it does not have"
        )
    return header
