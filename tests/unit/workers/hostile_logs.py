"""Logs that say one thing and hold another: small files that grow, last or repeat without end."""

import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import zstandard

from tests.tiny_logs import BEGIN_NS, CLOUD_TYPE, LIDAR

MAGIC = b"\x89MCAP0\r\n"


def record(opcode: int, body: bytes) -> bytes:
    """Write a record."""
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value: str | bytes) -> bytes:
    """Write a string with its length."""
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def mapping(values: Mapping[str, str]) -> bytes:
    """Write a map of strings with its length."""
    return text(b"".join(text(key) + text(value) for key, value in values.items()))


def message(channel: int, log_time_ns: int, data: bytes) -> bytes:
    """Write a Message record."""
    return record(5, struct.pack("<HIQQ", channel, 0, log_time_ns, log_time_ns) + data)


@dataclass(frozen=True)
class Chunk:
    """One chunk, and what the index says of it.

    Attributes:
        records: What is inside.
        start_ns: Earliest log time, as the index says.
        end_ns: Latest log time, as the index says.
        counts: Messages by channel, as the index says.
    """

    records: bytes
    start_ns: int
    end_ns: int
    counts: Mapping[int, int]


class RawLog:
    """A log written record by record, so that any of them may lie."""

    def __init__(
        self,
        topics: Sequence[str] = (LIDAR,),
        *,
        encoding: str = "cdr",
        schema_name: str = CLOUD_TYPE,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
    ) -> None:
        """Begin with one channel for each topic, numbered from 1, and metadata records."""
        self._head = record(
            3, struct.pack("<H", 1) + text(schema_name) + text("ros2msg") + text("")
        )
        for number, topic in enumerate(topics, 1):
            body = struct.pack("<HH", number, 1) + text(topic) + text(encoding) + text(b"")
            self._head += record(4, body)
        self._metadata = [
            (name, record(12, text(name) + mapping(values)))
            for name, values in (metadata or {}).items()
        ]
        self._packed: dict[bytes, bytes] = {}

    def write(self, path: Path, chunks: Iterable[Chunk], *, closed: bool = True) -> Path:
        """Write chunks, each followed by its message index, and the summary."""
        out = bytearray(MAGIC + record(1, text("ros2") + text("test")) + self._head)
        summary = bytearray(self._head)
        for name, whole in self._metadata:
            summary += record(13, struct.pack("<QQ", len(out), len(whole)) + text(name))
            out += whole
        for chunk in chunks:
            start = len(out)
            out += self._chunk(chunk)
            length = len(out) - start
            offsets = b""
            for channel, count in chunk.counts.items():
                offsets += struct.pack("<HQ", channel, len(out))
                out += record(7, struct.pack("<HI", channel, 16 * count) + bytes(16 * count))
            summary += record(
                8,
                struct.pack("<QQQQ", chunk.start_ns, chunk.end_ns, start, length)
                + text(offsets)
                + struct.pack("<Q", len(out) - start - length)
                + text("zstd")
                + struct.pack("<QQ", 0, len(chunk.records)),
            )
        if closed:
            out += record(15, bytes(4))
            begin = len(out)
            out += summary + record(2, struct.pack("<QQI", begin, 0, 0)) + MAGIC
        path.write_bytes(out)
        return path

    def _chunk(self, chunk: Chunk) -> bytes:
        if chunk.records not in self._packed:  # the same gigabyte is packed once
            self._packed = {chunk.records: zstandard.compress(chunk.records, 3)}
        packed = self._packed[chunk.records]
        return record(
            6,
            struct.pack(
                "<QQQII",
                chunk.start_ns,
                chunk.end_ns,
                len(chunk.records),
                zlib.crc32(chunk.records),
                4,
            )
            + b"zstd"
            + struct.pack("<Q", len(packed))
            + packed,
        )


def chunk_of(messages: Iterable[tuple[int, int, bytes]], *, index: bool = True) -> Chunk:
    """Make an honest chunk of messages: channel, log time and payload of each."""
    listed = list(messages)
    counts: dict[int, int] = {}
    for channel, _, _ in listed:
        counts[channel] = counts.get(channel, 0) + 1
    return Chunk(
        b"".join(message(*each) for each in listed),
        min(time_ns for _, time_ns, _ in listed),
        max(time_ns for _, time_ns, _ in listed),
        counts if index else {},
    )


def empty_messages(number: int, *, step_ns: int = 1000, begin_ns: int = BEGIN_NS) -> bytes:
    """Write messages without payload, as many as asked for."""
    return b"".join(message(1, begin_ns + each * step_ns, b"") for each in range(number))
