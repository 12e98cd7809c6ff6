"""MCAP footer: a part with a valid one was closed by its writer, is complete and grows no more."""

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
"""Bytes read first: the whole summary of all but the largest logs, and small logs as a whole."""


class StillGrowingError(TransientError):
    """A recording that was listed a moment ago is incomplete: its upload may be in progress."""


class PredictionsAwaitedError(TransientError):
    """The predictions next to a recording have not come yet."""


@dataclass(frozen=True, slots=True)
class TruncatedPart:
    """An object that ends without a valid footer, and its usable length.

    Attributes:
        key: Which object.
        size: Its bytes.
        seconds: From its first message to the last complete one.
    """

    key: str
    size: int
    seconds: float


def read_tail(reader: PartReader) -> memoryview:
    """Read the end of a part, once: the reader keeps it."""
    tail_bytes = min(reader.size, TAIL_BYTES)
    return reader.read(reader.size - tail_bytes, tail_bytes, keep=True)


def footer_of(tail: memoryview) -> Footer | None:
    """Read the footer record at the end of a part; None without a valid one."""
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
    """Return True for a part with MCAP's magic and a valid footer; it takes two small reads."""
    if footer_of(read_tail(reader)) is None:
        return False
    return bytes(reader.read(0, len(MAGIC))) == MAGIC
