"""A day of a log bucket in a minute: what becomes of each of its logs, from one seed.

Logs appear, grow, come in parts, are cut, replaced, deleted and brought back. How it is lived
through, while what watches and mines is killed, is in `day_system.py`.
"""

import io
import random
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any, Final, Literal

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from schemas.arrays import NS_PER_S
from tests.factories import SMALL_LIDAR, missed_and_phantom
from workers.lab.simulation.output.write import Identity, write_log
from workers.lab.simulation.world.street_builder import build_street

SECONDS: Final = 3
"""Of every log: so many scenes, each a shard of its own, so that a log is several leases."""

CHUNK_BYTES: Final = 1 << 17

PAUSE_NS: Final = 4 * NS_PER_S
"""Silence within a log: some shards hold no frame."""

TOO_LATE_NS: Final = 2**63 + 5
"""A log time that no signed number of 64 bits holds."""

Kind = Literal[
    "appears", "grows", "is whole", "gets a part", "is truncated", "is replaced", "is deleted",
    "is back",
]  # fmt: skip
"""What may happen to a log."""

After = Literal["nothing", "listed", "leased", "mined"]
"""What must have become of the log's last change before the next one comes."""


@dataclass(frozen=True, slots=True)
class Change:
    """Something that happens to an object of a log.

    Attributes:
        kind: What it looks like to a person.
        key: Of the object.
        data: All that it holds from now on; None: it is gone.
        after: What is waited for before.
    """

    kind: Kind
    key: str
    data: bytes | None
    after: After = "nothing"


@dataclass(frozen=True, slots=True)
class Story:
    """What happens to one log over the day.

    Attributes:
        log_id: The log.
        changes: In their order.
        ends: State of the log that `status` must tell in the evening; None: there is no such log.
    """

    log_id: str
    changes: tuple[Change, ...]
    ends: Literal["done", "refused"] | None = "done"


def stories(seed: int) -> list[Story]:
    """Make up a day: which streets are recorded, and where they are cut."""
    rng = random.Random(seed)  # noqa: S311  # the same seed must give the same day
    numbers = count(1000 * seed)

    def drive(vehicle: int) -> bytes:
        return street(next(numbers), vehicle=f"car-{vehicle}")

    def begin(log: bytes, least: float, most: float) -> bytes:
        return log[: int(len(log) * rng.uniform(least, most))]

    def story(name: str, *changes: tuple[Kind, bytes | None, After], ends: Any = "done") -> Story:
        told = (Change(kind, f"{name}.mcap", data, after) for kind, data, after in changes)
        return Story(name, tuple(told), ends)

    whole, grown, cut, first, second = (drive(vehicle) for vehicle in (0, 1, 3, 4, 4))
    gone, back, late, old, new = (drive(vehicle) for vehicle in (6, 7, 8, 9, 9))
    hasty, hastier, paused, far = drive(5), drive(5), drive(10), drive(11)
    return [
        story("car-0/am/whole", ("appears", whole, "nothing")),
        story(
            "car-1/am/grown",
            ("appears", begin(grown, 0.1, 0.3), "nothing"),
            ("grows", begin(grown, 0.3, 0.6), "nothing"),
            ("grows", begin(grown, 0.6, 0.9), "listed"),
            ("is whole", grown, "nothing"),
        ),
        _in_parts_story("car-2/am/split", drive(2)),
        story(
            "car-3/am/cut",
            ("appears", cut, "nothing"),
            ("is truncated", begin(cut, 0.4, 0.7), "mined"),
        ),
        story(
            "car-4/am/other",
            ("appears", first, "nothing"),
            ("is replaced", second, "mined"),
        ),
        story(
            "car-5/am/hasty",
            ("appears", hasty, "nothing"),
            ("is replaced", hastier, "leased"),
        ),
        story("car-5/am/noise", ("appears", b"no recording " * 4096, "nothing"), ends="refused"),
        story(
            "car-6/am/gone",
            ("appears", gone, "nothing"),
            ("is deleted", None, "mined"),
            ends=None,
        ),
        story(
            "car-7/am/back",
            ("appears", back, "nothing"),
            ("is deleted", None, "mined"),
            ("is back", back, "listed"),
        ),
        story(
            "car-8/pm/late",
            ("appears", begin(late, 0.55, 0.7), "nothing"),
            ("is whole", late, "mined"),
        ),
        story(
            "car-9/pm/swapped",
            ("appears", old, "nothing"),
            ("is replaced", new, "mined"),
            ("is back", old, "mined"),
        ),
        story("car-10/am/paused", ("appears", _with_a_pause(paused, rng), "nothing")),
        story("car-11/am/far", ("appears", _with_one_too_late(far), "nothing")),
    ]


def street(seed: int, *, vehicle: str) -> bytes:
    """Record a log whose model errs now and then, so that scenes differ in score."""
    world = build_street(seed, seconds=SECONDS, style="stands" if seed % 2 else "drives")
    out = io.BytesIO()
    write_log(
        out,
        world,
        lidar=SMALL_LIDAR,
        identity=Identity(vehicle=vehicle),
        planted=missed_and_phantom(world),
        chunk_bytes=CHUNK_BYTES,
    )
    return out.getvalue()


def _in_parts_story(log_id: str, log: bytes) -> Story:
    afters: tuple[After, ...] = ("nothing", "listed", "mined")
    changes = [
        Change("gets a part" if number else "appears", f"{log_id}_{number}.mcap", part, after)
        for number, (part, after) in enumerate(zip(_in_parts(log, 3), afters, strict=True))
    ]
    return Story(log_id, tuple(changes))


def _with_a_pause(log: bytes, rng: random.Random) -> bytes:
    """Let a log be silent in its middle; it is recorded 20 to 90 ms after the stamps."""

    def later(index: int, log_time_ns: int, data: bytes) -> tuple[int, bytes]:
        stamp_ns = log_time_ns + (PAUSE_NS if index >= 10 * SECONDS // 2 else 0)
        stamp = struct.pack("<iI", *divmod(stamp_ns, NS_PER_S))
        return stamp_ns + rng.randint(20, 90) * 1_000_000, data[:4] + stamp + data[12:]

    return _rewritten(log, later)


def _with_one_too_late(log: bytes) -> bytes:
    """Let the recorder's clock be wrong for one message."""
    return _rewritten(
        log, lambda index, log_time_ns, data: (TOO_LATE_NS if index == 7 else log_time_ns, data)
    )


def _rewritten(log: bytes, change: Callable[[int, int, bytes], tuple[int, bytes]]) -> bytes:
    """Write a log once more, each message with another log time and other bytes."""
    (written,) = _in_parts(log, 1, change)
    return written


def _in_parts(
    log: bytes,
    parts: int,
    change: Callable[[int, int, bytes], tuple[int, bytes]] = lambda _, at_ns, data: (at_ns, data),
) -> Iterator[bytes]:
    """Split a log as a recorder does: each part a file of its own with all that belongs in it."""
    reader = make_reader(io.BytesIO(log))
    metadata = list(reader.iter_metadata())
    messages = list(reader.iter_messages())
    each = -(-len(messages) // parts)
    for begin in range(0, len(messages), each):
        out = io.BytesIO()
        writer = Writer(out, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        for record in metadata:
            writer.add_metadata(record.name, record.metadata)
        schema, channel, _ = messages[0]
        assert schema is not None
        schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
        channel_id = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
        for index, (_, _, message) in enumerate(messages[begin : begin + each], start=begin):
            log_time_ns, data = change(index, message.log_time, message.data)
            writer.add_message(
                channel_id, log_time_ns, data, message.publish_time, sequence=message.sequence
            )
        writer.finish()  # type: ignore[no-untyped-call]  # upstream lacks the return type
        yield out.getvalue()
