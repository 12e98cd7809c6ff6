"""A day of a log bucket in a minute: what happens to its objects, played on a folder or on S3.

Logs appear, grow, come in parts, stay cut off, are replaced, deleted and brought back, while the
processes that watch and mine them are killed. What must be true afterwards is in
`test_day_in_a_minute.py`.
"""

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import obstore
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from obstore.store import ObjectStore

from workers.simulation.lidar import UNEVEN_64, Lidar
from workers.simulation.recorded import plan_mistakes
from workers.simulation.worlds import build_street
from workers.simulation.write import Identity, write_log

LIDAR = Lidar(elevation_deg=UNEVEN_64[::2], columns=192)
SECONDS = 4
"""Of every log: two scenes of the default grid."""


class Hand(Protocol):
    """Whoever drops logs in the bucket."""

    def put(self, key: str, data: bytes) -> None:
        """Write an object, or what is there of it so far."""
        ...

    def delete(self, key: str) -> None:
        """Remove it."""
        ...


class FolderHand:
    """Writes files as a recorder does: in place, piece by piece."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def put(self, key: str, data: bytes) -> None:
        """Append where the file is a beginning of the data, else replace it."""
        path = self._folder / key
        path.parent.mkdir(parents=True, exist_ok=True)
        there = path.read_bytes() if path.exists() else b""
        if there and data.startswith(there):
            with path.open("ab") as file:
                file.write(data[len(there) :])
            return
        new = path.with_suffix(".new")
        new.write_bytes(data)
        new.replace(path)

    def delete(self, key: str) -> None:
        """Remove the file."""
        (self._folder / key).unlink()


class StoreHand:
    """Uploads objects, whole each time, as S3 wants it."""

    def __init__(self, store: ObjectStore) -> None:
        self._store = store

    def put(self, key: str, data: bytes) -> None:
        """Upload it."""
        obstore.put(self._store, key, data)

    def delete(self, key: str) -> None:
        """Remove it."""
        obstore.delete(self._store, key)


@dataclass(frozen=True, slots=True)
class Step:
    """One thing that happens.

    Attributes:
        what: For the log of the day.
        happens: What to do to the bucket or to a process.
        until: What the service must have come to before the day goes on: a log id and the state
            that `status` gives it; None: the day goes on after a moment.
    """

    what: str
    happens: Callable[[], None]
    until: tuple[str, str] | None = None


def street(seed: int, *, seconds: int = SECONDS) -> bytes:
    """Record a log whose model errs now and then, so that scenes differ in score."""
    world = build_street(seed, seconds=seconds, style="stands" if seed % 2 else "drives")
    out = io.BytesIO()
    write_log(
        out,
        world,
        lidar=LIDAR,
        identity=Identity(vehicle=f"car-{seed}"),
        mistakes=plan_mistakes(world, lidar=LIDAR),
        chunk_bytes=1 << 17,
    )
    return out.getvalue()


def in_parts(log: bytes, parts: int) -> list[bytes]:
    """Split a log as a recorder does: each part a file of its own with all that belongs in it."""
    reader = make_reader(io.BytesIO(log))
    metadata = list(reader.iter_metadata())
    messages = list(reader.iter_messages())
    each = -(-len(messages) // parts)
    return [
        _part(metadata, messages[begin : begin + each]) for begin in range(0, len(messages), each)
    ]


def _part(metadata: list, messages: list) -> bytes:  # type: ignore[type-arg]  # mcap's own tuples
    out = io.BytesIO()
    writer = Writer(out, chunk_size=1 << 17, compression=CompressionType.ZSTD)
    writer.start(profile="ros2")
    for record in metadata:
        writer.add_metadata(record.name, record.metadata)
    schema, channel, _ = messages[0]
    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
    channel_id = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
    for _, _, message in messages:
        writer.add_message(
            channel_id,
            message.log_time,
            message.data,
            message.publish_time,
            sequence=message.sequence,
        )
    writer.finish()  # type: ignore[no-untyped-call]  # upstream lacks the return type
    return out.getvalue()


@dataclass(frozen=True, slots=True)
class Kills:
    """How to kill what runs; each comes back by itself or by this call."""

    service: Callable[[], None]
    worker: Callable[[], None]
    router: Callable[[], None]
    store: Callable[[], None]


def day(hand: Hand, kills: Kills) -> Iterator[Step]:
    """Play the day; the log ids at its end are those of `STAYS`."""
    one, grown, split, cut, first, second, gone, back, late = (street(seed) for seed in range(9))
    parts = in_parts(split, 3)
    half = len(cut) // 2

    def put(key: str, data: bytes) -> Callable[[], None]:
        return lambda: hand.put(key, data)

    def delete(key: str) -> Callable[[], None]:
        return lambda: hand.delete(key)

    yield Step("a log appears", put("car-0/am/whole.mcap", one))
    yield Step("another begins to grow", put("car-1/am/grown.mcap", grown[: len(grown) // 5]))
    yield Step("first of three parts", put("car-2/am/split_0.mcap", parts[0]))
    yield Step("it grows", put("car-1/am/grown.mcap", grown[: len(grown) // 2]))
    yield Step("a log is mined", lambda: None, until=("car-0/am/whole", "done"))
    yield Step("service killed", kills.service)
    yield Step("a log is cut off", put("car-3/am/cut.mcap", cut[:half]))
    yield Step("one that will go", put("car-6/am/gone.mcap", gone))
    yield Step("it grows", put("car-1/am/grown.mcap", grown[: len(grown) * 4 // 5]))
    yield Step("one that will be replaced", put("car-4/am/other.mcap", first))
    yield Step("worker killed", kills.worker)
    yield Step("second part", put("car-2/am/split_1.mcap", parts[1]))
    yield Step("it has grown", put("car-1/am/grown.mcap", grown))
    yield Step("the first is mined", lambda: None, until=("car-4/am/other", "done"))
    yield Step("replaced", put("car-4/am/other.mcap", second))
    yield Step("store killed", kills.store)
    yield Step("no log at all", put("car-5/am/noise.mcap", b"not a recording " * 4096))
    yield Step("one that goes and comes back", put("car-7/am/back.mcap", back))
    yield Step("it is mined", lambda: None, until=("car-7/am/back", "done"))
    yield Step("deleted", delete("car-7/am/back.mcap"))
    yield Step("router killed", kills.router)
    yield Step("deleted", delete("car-6/am/gone.mcap"))
    yield Step("last part", put("car-2/am/split_2.mcap", parts[2]))
    yield Step("cut off, as far as it goes", put("car-8/pm/late.mcap", late[: len(late) * 2 // 3]))
    yield Step("it is mined as far as it goes", lambda: None, until=("car-8/pm/late", "done"))
    yield Step("the rest arrives", put("car-8/pm/late.mcap", late))
    yield Step("it is back", put("car-7/am/back.mcap", back))
    yield Step("worker killed", kills.worker)
    yield Step("service killed", kills.service)
    yield Step("store killed", kills.store)


STAYS = {
    "car-0/am/whole": "done",
    "car-1/am/grown": "done",
    "car-2/am/split": "done",
    "car-3/am/cut": "done",
    "car-4/am/other": "done",
    "car-5/am/noise": "refused",
    "car-7/am/back": "done",
    "car-8/pm/late": "done",
}
"""What lies in the bucket at the end of the day, and what becomes of it."""
