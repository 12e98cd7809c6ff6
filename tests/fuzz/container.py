"""Writes MCAP files from records, whose lies it can be made to write with right checksums."""

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import lz4.frame
import zstandard
from mcap.opcode import Opcode

MAGIC: Final = b"\x89MCAP0\r\n"
SHARED: Final = (Opcode.SCHEMA, Opcode.CHANNEL)
"""Records that lie in the chunks, and again in the summary."""


@dataclass(slots=True)
class Record:
    """One record: what kind, and its content.

    Attributes:
        opcode: What kind.
        body: Its content.
        stated: Its length as its header says; None: the true one.
    """

    opcode: int
    body: bytes
    stated: int | None = None

    def bytes(self) -> bytes:
        """Lay it out with its header."""
        stated = len(self.body) if self.stated is None else self.stated
        return struct.pack("<BQ", self.opcode, stated) + self.body


@dataclass(frozen=True, slots=True)
class Container:
    """How records are put in a file."""

    compression: str = "zstd"
    chunked: bool = True
    indexed: bool = True
    chunk_bytes: int = 40_000

    def __str__(self) -> str:
        chunks = (self.compression or "uncompressed") if self.chunked else "no"
        return f"{chunks} chunks, {'with' if self.indexed else 'without'} index"


@dataclass(frozen=True, slots=True)
class Chunk:
    """What a Chunk record says, and its records as they are stored."""

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: bytes
    packed: bytes
    stated: int

    @classmethod
    def of(cls, body: bytes) -> "Chunk":
        """Read one that `bytes` wrote."""
        start_ns, end_ns, size, crc, name = struct.unpack_from("<QQQII", body)
        at = 32 + name + 8
        (stated,) = struct.unpack_from("<Q", body, 32 + name)
        return cls(start_ns, end_ns, size, crc, body[32 : 32 + name], body[at:], stated)

    def bytes(self) -> bytes:
        """Lay it out."""
        head = (self.start_ns, self.end_ns, self.size, self.crc, len(self.compression))
        numbers = [number & (2**64 - 1) for number in head[:3]]
        return (
            struct.pack("<QQQII", *numbers, *head[3:])
            + self.compression
            + struct.pack("<Q", self.stated)
            + self.packed
        )


@dataclass(slots=True)
class Draft:
    """A log before it is written. Mutations change it at any of the stages that it goes through.

    Attributes:
        records: Of the data section, in their order.
        container: How they are put in a file.
        on_pieces: Change the records of the file as they will lie in it, chunks made.
        on_summary: Change the records of the summary; its checksum is made after.
        on_bytes: Change the bytes of the file.
    """

    records: list[Record]
    container: Container
    on_pieces: list[Callable[[list[Record]], None]] = field(default_factory=list)
    on_summary: list[Callable[[list[Record]], None]] = field(default_factory=list)
    on_bytes: list[Callable[[bytearray], None]] = field(default_factory=list)

    def write(self) -> bytes:
        """Write the file."""
        pieces = [Record(Opcode.HEADER, text("") + text("fuzz")), *self._packed()]
        for change in self.on_pieces:
            change(pieces)
        out = bytearray(MAGIC)
        offsets = []
        for piece in pieces:
            offsets.append(len(out))
            out += piece.bytes()
        out += Record(Opcode.DATA_END, bytes(4)).bytes()
        summary = list(_summary(self.records, pieces, offsets)) if self.container.indexed else []
        for change in self.on_summary:
            change(summary)
        begin = len(out)
        out += b"".join(piece.bytes() for piece in summary)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, begin if summary else 0, 0)
        crc = zlib.crc32(bytes(out[begin:]) + footer)
        out += footer + struct.pack("<I", crc) + MAGIC
        for damage in self.on_bytes:
            damage(out)
        return bytes(out)

    def _packed(self) -> Iterator[Record]:
        if not self.container.chunked:
            yield from self.records
            return
        inside: list[Record] = []
        size = 0
        for record in self.records:
            if record.opcode not in (*SHARED, Opcode.MESSAGE):
                yield record
                continue
            inside.append(record)
            size += len(record.body)
            if size >= self.container.chunk_bytes:
                yield from _chunk(inside, self.container)
                inside, size = [], 0
        if inside:
            yield from _chunk(inside, self.container)


def compress(records: bytes, compression: str) -> bytes:
    """Compress as a chunk of this kind is."""
    if compression == "zstd":
        return zstandard.ZstdCompressor(level=1).compress(records)
    if compression == "lz4":
        packed: bytes = lz4.frame.compress(records)
        return packed
    return records


def _chunk(inside: list[Record], container: Container) -> Iterator[Record]:
    records = b"".join(record.bytes() for record in inside)
    times: list[int] = []
    entries: dict[int, list[tuple[int, int]]] = {}
    offset = 0
    for record in inside:
        if record.opcode == Opcode.MESSAGE and len(record.body) >= 22:
            channel_id, _, log_time_ns, _ = struct.unpack_from("<HIQQ", record.body)
            times.append(log_time_ns)
            entries.setdefault(channel_id, []).append((log_time_ns, offset))
        offset += len(record.bytes())
    packed = compress(records, container.compression)
    yield Record(
        Opcode.CHUNK,
        Chunk(
            start_ns=min(times, default=0),
            end_ns=max(times, default=0),
            size=len(records),
            crc=zlib.crc32(records),
            compression=container.compression.encode(),
            packed=packed,
            stated=len(packed),
        ).bytes(),
    )
    if container.indexed:
        for channel_id, found in entries.items():
            body = b"".join(struct.pack("<QQ", *entry) for entry in found)
            yield Record(Opcode.MESSAGE_INDEX, struct.pack("<HI", channel_id, len(body)) + body)


def _summary(records: list[Record], pieces: list[Record], offsets: list[int]) -> Iterator[Record]:
    yield from (replace(record) for record in records if record.opcode in SHARED)
    counts: Counter[int] = Counter()
    times = []
    for record in records:
        if record.opcode == Opcode.MESSAGE and len(record.body) >= 22:
            channel_id, _, log_time_ns, _ = struct.unpack_from("<HIQQ", record.body)
            counts[channel_id] += 1
            times.append(log_time_ns)
    chunks = [number for number, piece in enumerate(pieces) if piece.opcode == Opcode.CHUNK]
    metadata = [number for number, piece in enumerate(pieces) if piece.opcode == Opcode.METADATA]
    per_channel = b"".join(struct.pack("<HQ", *item) for item in counts.items())
    yield Record(
        Opcode.STATISTICS,
        struct.pack("<QHIIII", sum(counts.values()), 1, len(counts), 0, len(metadata), len(chunks))
        + struct.pack("<QQI", min(times, default=0), max(times, default=0), len(per_channel))
        + per_channel,
    )
    for number in chunks:
        yield _chunk_index(pieces, offsets, number)
    for number in metadata:
        body = struct.pack("<QQ", offsets[number], len(pieces[number].bytes()))
        yield Record(Opcode.METADATA_INDEX, body + _name_of(pieces[number].body))


def _chunk_index(pieces: list[Record], offsets: list[int], number: int) -> Record:
    piece = pieces[number]
    try:
        chunk = Chunk.of(piece.body)
    except struct.error:  # a mutation has cut it: the index says what it would
        chunk = Chunk(0, 0, 0, 0, b"", b"", 0)
    indexes = []
    for following in range(number + 1, len(pieces)):
        if pieces[following].opcode != Opcode.MESSAGE_INDEX:
            break
        channel_id = int.from_bytes(pieces[following].body[:2], "little")
        indexes.append(struct.pack("<HQ", channel_id, offsets[following]))
    after = offsets[number] + len(piece.bytes())
    index_bytes = sum(len(pieces[number + 1 + each].bytes()) for each in range(len(indexes)))
    offsets_by_channel = b"".join(indexes)
    return Record(
        Opcode.CHUNK_INDEX,
        struct.pack("<QQQQ", chunk.start_ns, chunk.end_ns, offsets[number], after - offsets[number])
        + struct.pack("<I", len(offsets_by_channel))
        + offsets_by_channel
        + struct.pack("<QI", index_bytes, len(chunk.compression))
        + chunk.compression
        + struct.pack("<QQ", len(chunk.packed), chunk.size & (2**64 - 1)),
    )


def _name_of(metadata: bytes) -> bytes:
    length = int.from_bytes(metadata[:4], "little")
    return metadata[: 4 + length]


def text(value: str | bytes) -> bytes:
    """Lay out a string."""
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def schema(number: int, name: str | bytes, encoding: str | bytes, data: bytes) -> Record:
    """Make a Schema record."""
    said = text(name) + text(encoding) + text(data)
    return Record(Opcode.SCHEMA, struct.pack("<H", number) + said)


def channel(number: int, schema_id: int, topic: str | bytes, encoding: str | bytes) -> Record:
    """Make a Channel record."""
    said = text(topic) + text(encoding) + text(b"")
    # Its metadata is a map without entries: a length of 0, as an empty text has.
    return Record(Opcode.CHANNEL, struct.pack("<HH", number, schema_id) + said)


def message(channel_id: int, sequence: int, log_time_ns: int, data: bytes) -> Record:
    """Make a Message record."""
    head = struct.pack("<HIQQ", channel_id, sequence, log_time_ns, log_time_ns)
    return Record(Opcode.MESSAGE, head + data)


def metadata(name: str | bytes, entries: Mapping[str, str | bytes]) -> Record:
    """Make a Metadata record."""
    laid = b"".join(text(key) + text(value) for key, value in entries.items())
    return Record(Opcode.METADATA, text(name) + text(laid))
