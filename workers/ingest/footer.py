"""Whether a part was closed by its writer: then it is whole, and grows no more."""

from dataclasses import dataclass
from typing import Final

from mcap.opcode import Opcode
from mcap.records import Footer

from schemas.errors import TransientError
from workers.ingest.part_reader import PartReader
from workers.ingest.records import (
    FOOTER_BYTES,
    HEADER_BYTES,
    MAGIC,
    RecordMalformedError,
    parse,
    record_header,
)

TAIL_BYTES: Final = 1024 * 1024
"""Read first: holds the whole summary of all but the largest logs, and small logs as a whole."""


class StillGrowingError(TransientError):
    """A recording that was listed a moment ago is not whole yet: its upload may be under way."""

    def __init__(self, *, key: str, size: int) -> None:
        """Keep which object, and how far it is."""
        super().__init__(
            f"the file has no valid footer yet ({key}, {size} bytes): it is planned when that "
            "comes, or when it has not changed for a while"
        )
        self.key, self.size = key, size


@dataclass(frozen=True, slots=True)
class TruncatedPart:
    """An object that ends without a valid footer, and how far it can be used all the same.

    Attributes:
        key: Which object.
        size: Its bytes.
        seconds: From its first message to the last that lies whole in it.
    """

    key: str
    size: int
    seconds: float


def read_tail(reader: PartReader) -> memoryview:
    """Read the end of a part, once: it is held for whoever asks next."""
    tail_bytes = min(reader.size, TAIL_BYTES)
    return reader.read(reader.size - tail_bytes, tail_bytes, keep=True)


def footer_of(tail: memoryview) -> Footer | None:
    """Read the footer record at the end of a part; None where there is none that is valid."""
    end = len(tail) - len(MAGIC)
    if end < FOOTER_BYTES or bytes(tail[end:]) != MAGIC:
        return None
    record = tail[end - FOOTER_BYTES : end]
    if record_header(record, 0) != (Opcode.FOOTER, FOOTER_BYTES - HEADER_BYTES):
        return None
    try:
        return parse(Footer, record[HEADER_BYTES:])
    except RecordMalformedError:
        return None


def is_closed(reader: PartReader) -> bool:
    """Whether a part begins as an MCAP file and ends in a valid footer: two small reads at most."""
    if footer_of(read_tail(reader)) is None:
        return False
    return bytes(reader.read(0, len(MAGIC))) == MAGIC
