"""What is done to a log before it is mined: each damages another layer, and those within it not.

Checksums are made after the mutation wherever that leaves the log readable one layer deeper.
"""

import random
import struct
import zlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from tests.fuzz.container import Chunk, Draft, Record, compress, metadata, text

Mutation = Callable[[Draft, random.Random], None]

EXTREMES: Final = (
    0, 1, 2, 3, 21, 22, 127, 128, 255, 256, 65_535, 65_536, 2**31 - 1, 2**31, 2**32 - 2,
    2**32 - 1, 2**32, 2**62, 2**63 - 1, 2**63, 2**64 - 2, 2**64 - 1,
)  # fmt: skip
NS_EXTREMES: Final = (
    0, 1, 10**9, 2**53, 2**62, 2**63 - 1, 2**63, 2**63 + 1, 2**64 - 1, 9_223_372_036_854_775_000,
    1_700_000_000 * 10**9 - 86_400 * 10**9, 1_700_000_000 * 10**9 + 40 * 10**9,
    1_700_000_000 * 10**9 + 400 * 86_400 * 10**9,
)  # fmt: skip
"""Log times: of no use at all, beyond an int64, a day early, 40 s and a year late."""

LONG: Final = (
    b"x" * 300, b"x" * 70_000, b"x" * 1_000_000, b"a/" * 2_000, b"\xff\xfe\xed", b"\0", b"",
    b"new\nline\ttab\x1b[31m", "\u202eemoji \U0001f697".encode(), b"../../etc/passwd",
    b"@adv/**", b"$*/*?#", b"%2E%2e/..", b"{vehicle}", b" ", b'"\\u0000"', b"NaN", b"//",
)  # fmt: skip


def bits(draft: Draft, chance: random.Random) -> None:
    """Flip some bits anywhere in the file."""

    def damage(data: bytearray) -> None:
        for _ in range(chance.randint(1, 8)):
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)

    draft.on_bytes.append(damage)


def cut(draft: Draft, chance: random.Random) -> None:
    """Cut the file, and now and then go on with other bytes."""

    def damage(data: bytearray) -> None:
        del data[chance.randrange(len(data)) :]
        if chance.random() < 0.2:
            data += bytes(chance.randrange(200))

    draft.on_bytes.append(damage)


def hole(draft: Draft, chance: random.Random) -> None:
    """Overwrite, remove, repeat or insert a stretch of the file."""

    def damage(data: bytearray) -> None:
        at, length = chance.randrange(len(data)), chance.randint(1, 5_000)
        match chance.randrange(4):
            case 0:
                del data[at : at + length]
            case 1:
                data[at:at] = data[at : at + length]
            case 2:
                data[at:at] = chance.randbytes(length)
            case _:
                fill = chance.choice((b"\0", b"\xff", b"\x06", b"\x05"))
                data[at : at + length] = fill * len(data[at : at + length])

    draft.on_bytes.append(damage)


def lengths(draft: Draft, chance: random.Random) -> None:
    """Let a record say another length than it has, within a chunk or outside."""

    def lie(records: list[Record]) -> None:
        record = chance.choice(records)
        near = len(record.body) + chance.choice((-9, -1, 1, 9))
        record.stated = max(0, chance.choice((*EXTREMES, near)))

    if chance.random() < 0.5:
        lie(draft.records)
    else:
        draft.on_pieces.append(lie)


def order(draft: Draft, chance: random.Random) -> None:
    """Repeat, drop, swap, shuffle or move records; every checksum is right."""
    records = draft.records
    for _ in range(chance.randint(1, 4)):
        one, other = chance.randrange(len(records)), chance.randrange(len(records))
        match chance.randrange(5):
            case 0:
                copies = chance.choice((1, 2, 50))
                records[one:one] = [replace(records[one]) for _ in range(copies)]
            case 1 if len(records) > 1:
                del records[one]
            case 2:
                records[one], records[other] = records[other], records[one]
            case 3:
                chance.shuffle(records)
            case _:
                records.insert(other, replace(records.pop(one)))
        if not records:
            return


def kinds(draft: Draft, chance: random.Random) -> None:
    """Give a record another opcode, another channel or an end that is missing."""
    record = chance.choice(draft.records)
    match chance.randrange(4):
        case 0:
            record.opcode = chance.choice((*range(0, 17), 0x80, 0xFF))
        case 1:
            record.body = record.body[: chance.randrange(len(record.body) + 1)]
        case 2:
            channel = chance.choice((0, 1, 2, 3, 4, 65_535))
            record.body = struct.pack("<H", channel) + record.body[2:]
        case _:
            record.body += chance.randbytes(chance.choice((1, 100, 70_000)))


def payload_bits(draft: Draft, chance: random.Random) -> None:
    """Flip bits within a message; the chunk's checksum is right."""
    for record in _messages(draft, chance):
        body = bytearray(record.body)
        for _ in range(chance.randint(1, 16)):
            place = chance.choice((chance.randrange(22, len(body)), 22 + chance.randrange(200)))
            body[min(place, len(body) - 1)] ^= 1 << chance.randrange(8)
        record.body = bytes(body)


def payload_words(draft: Draft, chance: random.Random) -> None:
    """Put an extreme in the place of a number of a message: its sizes, counts, steps and kinds."""
    for record in _messages(draft, chance):
        body = bytearray(record.body)
        for _ in range(chance.randint(1, 3)):
            size = chance.choice((1, 4, 4, 4, 8))
            at = 26 + chance.randrange(0, min(320, len(body) - 26)) // size * size
            number = chance.choice(EXTREMES) & (2 ** (8 * size) - 1)
            body[at : at + size] = number.to_bytes(size, "little")
        record.body = bytes(body)


def payload_cut(draft: Draft, chance: random.Random) -> None:
    """Cut messages, empty them, or let them go on too long."""
    for record in _messages(draft, chance):
        keep = chance.choice((0, 1, 4, 12, chance.randrange(len(record.body) - 22)))
        record.body = record.body[: 22 + keep]
        if chance.random() < 0.2:
            record.body += bytes(chance.choice((1, 1_000, 1_000_000)))


def payload_text(draft: Draft, chance: random.Random) -> None:
    """Replace text within messages by other text of the same length, or of another in JSON."""
    old = chance.choice((b"lidar", b"x", b"label", b"motion", b"intensity", b"fields", b"data"))
    new = chance.choice((b"NaN", b"-1e999", b"1" * 5_000, b"\\ud800", b"[" * 3_000, b"\xff", b"y"))
    for record in _messages(draft, chance):
        if record.body[22:23] != b"{":
            new = (new * len(old))[: len(old)]
        record.body = record.body[:22] + record.body[22:].replace(old, new, chance.randint(1, 3))


def points(draft: Draft, chance: random.Random) -> None:
    """Give the points of whole clouds values that no lidar measures."""
    value = chance.choice(
        (float("nan"), float("inf"), -float("inf"), 3e38, -3e38, 1e-45, 0.0, 1e9, 65_504.0)
    )
    share = chance.choice((0.01, 0.3, 1.0))
    said = struct.pack("<f", value)
    for record in _messages(draft, chance):
        if record.body[22:23] == b"{":
            continue
        body = bytearray(record.body)
        for at in range(len(body) % 4 + 256, len(body) - 4, 4):
            if chance.random() < share:
                body[at : at + 4] = said
        record.body = bytes(body)


def times(draft: Draft, chance: random.Random) -> None:
    """Put the log time of messages, and now and then their publish time, to an extreme."""
    for record in _messages(draft, chance):
        log_ns = chance.choice(NS_EXTREMES)
        published_ns = chance.choice((log_ns, chance.choice(NS_EXTREMES)))
        record.body = record.body[:6] + struct.pack("<QQ", log_ns, published_ns) + record.body[22:]


def stamps(draft: Draft, chance: random.Random) -> None:
    """Put the stamp within messages to an extreme, or shift it; log times stay."""
    sec = chance.choice((0, 1, 2**31 - 1, 2**31, 2**32 - 1, 1_700_000_040, 1_699_999_990))
    nanosec = chance.choice((0, 999_999_999, 10**9, 2**31, 2**32 - 1))
    for record in _messages(draft, chance):
        at = 22 + 4  # CDR after its encapsulation, ROS 1 after its sequence number
        if record.body[22:23] == b"{":
            said = f'"sec": {sec}'.encode()
            record.body = record.body[:22] + record.body[22:].replace(b'"sec": 1700000000', said)
        else:
            stamp = struct.pack("<II", sec, nanosec)
            record.body = record.body[:at] + stamp + record.body[at + 8 :]


def strings(draft: Draft, chance: random.Random) -> None:
    """Make a name of a schema, channel or metadata record huge, empty, or no text."""
    said = [each for each in draft.records if each.opcode in (3, 4, 12)]
    if not said:
        return
    record = chance.choice(said)
    new = chance.choice(LONG)
    if record.opcode == Opcode.METADATA:
        name = chance.choice(("counterpoint.log", "counterpoint.classes", "another"))
        key = chance.choice(("vehicle", "date", "software_version", "40", "10", "99999999999"))
        wrong = chance.choice((new, b'{"name": "' + new + b'"}', b"[1]", b"{}", b"null"))
        record.body = metadata(name, {key: wrong, "vehicle": new}).body
        return
    head = {Opcode.SCHEMA: 2, Opcode.CHANNEL: 4}[Opcode(record.opcode)]
    fields = _texts(record.body[head:])
    if fields:
        which = chance.randrange(len(fields))
        fields[which] = new
        record.body = record.body[:head] + b"".join(map(text, fields))


def chunks(draft: Draft, chance: random.Random) -> None:
    """Let a chunk say another size, time, checksum or compression than it has."""

    def lie(pieces: list[Record]) -> None:
        found = [piece for piece in pieces if piece.opcode == Opcode.CHUNK]
        for piece in chance.sample(found, min(len(found), chance.randint(1, 3))):
            said = Chunk.of(piece.body)
            number = chance.choice((*EXTREMES, said.size - 1, said.size + 1))
            match chance.randrange(6):
                case 0:
                    said = replace(said, size=number)
                case 1:
                    said = replace(said, start_ns=chance.choice(NS_EXTREMES))
                case 2:
                    said = replace(said, end_ns=chance.choice(NS_EXTREMES))
                case 3:
                    said = replace(said, crc=chance.choice((0, 1, 2**32 - 1)))
                case 4:
                    names = (b"", b"lz4", b"zstd", b"gzip", b"\xff" * 64, b"z" * 70_000)
                    said = replace(said, compression=chance.choice(names))
                case _:
                    said = replace(said, stated=number % 2**64)
            piece.body = said.bytes()

    draft.on_pieces.append(lie)


def frames(draft: Draft, chance: random.Random) -> None:
    """Replace the compressed records of a chunk: by a bomb, nothing, another kind, two frames."""

    def swap(pieces: list[Record]) -> None:
        found = [piece for piece in pieces if piece.opcode == Opcode.CHUNK]
        for piece in chance.sample(found, min(len(found), chance.randint(1, 2))):
            said = Chunk.of(piece.body)
            name = chance.choice(("zstd", "lz4"))
            bomb = bytes(chance.choice((1 << 20, 64 << 20)))
            packed = chance.choice(
                (
                    lambda name=name, bomb=bomb: compress(bomb, name),
                    lambda bomb=bomb: zstandard.ZstdCompressor(write_content_size=False).compress(
                        bomb
                    ),
                    lambda: b"",
                    lambda: b"\x50\x2a\x4d\x18" + struct.pack("<I", 2**32 - 1),
                    lambda: b"\x50\x2a\x4d\x18" + struct.pack("<I", 8) + bytes(8),
                    lambda said=said: said.packed + said.packed,
                    lambda said=said: said.packed[: len(said.packed) // 2],
                    lambda said=said: chance.randbytes(len(said.packed)),
                    lambda: zstandard.ZstdCompressor().compress(b""),
                    lambda: bytes(lz4.frame.compress(b"")),
                )
            )()
            size = chance.choice((said.size, len(bomb), 0, 2**28, 2**28 + 1, 2**40))
            piece.body = replace(
                said,
                compression=name.encode(),
                packed=packed,
                stated=len(packed),
                size=size,
                crc=chance.choice((0, said.crc)),
            ).bytes()

    draft.on_pieces.append(swap)


def deep(draft: Draft, chance: random.Random) -> None:
    """Flip bits of a chunk's records before they are compressed again, all checksums right."""

    def flip(pieces: list[Record]) -> None:
        found = [piece for piece in pieces if piece.opcode == Opcode.CHUNK]
        if not found:
            return
        piece = chance.choice(found)
        said = Chunk.of(piece.body)
        kind = said.compression.decode()
        try:
            if kind == "zstd":
                records = bytearray(zstandard.ZstdDecompressor().decompress(said.packed))
            else:
                records = bytearray(lz4.frame.decompress(said.packed) if kind else said.packed)
        except (RuntimeError, zstandard.ZstdError):
            return
        for _ in range(chance.randint(1, 20)):
            records[chance.randrange(len(records))] ^= 1 << chance.randrange(8)
        packed = compress(bytes(records), kind)
        crc = zlib.crc32(bytes(records))
        piece.body = replace(said, packed=packed, stated=len(packed), crc=crc).bytes()

    draft.on_pieces.append(flip)


def index(draft: Draft, chance: random.Random) -> None:
    """Let the summary say other places, times, counts and names; its checksum is right."""

    def lie(summary: list[Record]) -> None:
        if not summary:
            return
        for _ in range(chance.randint(1, 4)):
            record = chance.choice(summary)
            match chance.randrange(5):
                case 0 if len(record.body) >= 8:
                    body = bytearray(record.body)
                    at = chance.randrange(0, len(body) - 7, 8)
                    body[at : at + 8] = chance.choice(EXTREMES + NS_EXTREMES).to_bytes(8, "little")
                    record.body = bytes(body)
                case 1 if len(summary) > 1:
                    summary.remove(record)
                case 2:
                    summary += [replace(record) for _ in range(chance.choice((1, 300)))]
                case 3:
                    record.body = record.body[: chance.randrange(len(record.body) + 1)]
                case _:
                    record.stated = chance.choice(EXTREMES)

    draft.on_summary.append(lie)


def footer(draft: Draft, chance: random.Random) -> None:
    """Let the footer point elsewhere, with or without a checksum that fits."""

    def lie(data: bytearray) -> None:
        at = len(data) - 8 - 20
        struct.pack_into("<Q", data, at + 8 * chance.randrange(2), chance.choice(EXTREMES))
        if chance.random() < 0.7:
            struct.pack_into("<I", data, at + 16, 0)

    draft.on_bytes.append(lie)


def crowd(draft: Draft, chance: random.Random) -> None:
    """Add thousands of channels, schemas, metadata records, or tiny messages."""
    match chance.randrange(4):
        case 0:
            for number in range(4, 5_000):
                head = struct.pack("<HH", number, 1)
                said = text(f"/t{number}") + text("cdr") + text(b"")
                draft.records.insert(4, Record(Opcode.CHANNEL, head + said))
        case 1:
            empty = metadata("counterpoint.classes", {str(n): "{}" for n in range(2_000)})
            draft.records[:0] = [replace(empty) for _ in range(20)]
        case 2:
            tiny = [each for each in draft.records if each.opcode == Opcode.MESSAGE][:1]
            draft.records += [
                Record(
                    Opcode.MESSAGE,
                    each.body[:6]
                    + struct.pack("<QQ", 1_700_000_000 * 10**9 + n * 10**9, 0)
                    + each.body[22:40],
                )
                for each in tiny
                for n in range(5_000)
            ]
        case _:
            draft.container = replace(draft.container, chunk_bytes=1)
            last = [each for each in draft.records if each.opcode == Opcode.MESSAGE]
            for number, each in enumerate(last):
                at_ns = 1_700_000_000 * 10**9 + number * chance.choice((10, 86_400)) * 10**9
                each.body = each.body[:6] + struct.pack("<QQ", at_ns, 0) + each.body[22:]


MUTATIONS: Final[Mapping[str, Mutation]] = {
    mutation.__name__: mutation
    for mutation in (
        bits, cut, hole, lengths, order, kinds, payload_bits, payload_words, payload_cut,
        payload_text, points, times, stamps, strings, chunks, frames, deep, index, footer, crowd,
    )
}  # fmt: skip


def mutate(draft: Draft, chance: random.Random, names: tuple[str, ...]) -> None:
    """Do several things to a log, one after the other."""
    for name in names:
        if draft.records:
            MUTATIONS[name](draft, chance)


def _messages(draft: Draft, chance: random.Random) -> list[Record]:
    """Choose one message, some, or all of them: those of an unharmed layout."""
    found = [
        each for each in draft.records if each.opcode == Opcode.MESSAGE and len(each.body) > 40
    ]
    share = chance.choice((0.0, 0.3, 1.0))
    chosen = [each for each in found if chance.random() < share]
    return chosen or (chance.sample(found, 1) if found else [])


def _texts(body: bytes) -> list[bytes]:
    found, at = [], 0
    while at + 4 <= len(body):
        (length,) = struct.unpack_from("<I", body, at)
        found.append(body[at + 4 : at + 4 + length])
        at += 4 + length
    return found
