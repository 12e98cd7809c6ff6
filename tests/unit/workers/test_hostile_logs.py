"""Planning a log that lies takes little memory and time, and ends in a sentence or in damage."""

import json
import struct
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from schemas.arrays import NS_PER_S
from schemas.bounds import MAX_PLAN_BYTES
from schemas.work import LogPlan
from tests.tiny_logs import BEGIN_NS, ring
from tests.unit.workers.hostile_logs import (
    Chunk,
    RawLog,
    chunk_of,
    empty_messages,
    message,
    record,
    text,
)

MIB = 1024 * 1024
MOST_MEMORY = 600 * MIB
MOST_SECONDS = 60.0
"""Of the processor's time; about twice what the worst of them takes."""

PLAN_IT = """
import resource, sys, time
from schemas.transport.bucket import open_bucket
from schemas.mining import MiningSettings
from tests.tiny_logs import only_recording
from workers.ingest.plan import plan_recording
from workers.memory import peak_memory_bytes

if limit := int(sys.argv[2]):
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
bucket = open_bucket(sys.argv[1])
settings = MiningSettings(bucket="memory://", artifacts="memory://")
began = time.process_time()
plan = plan_recording(bucket, only_recording(bucket), settings)
took = time.process_time() - began
print(took, peak_memory_bytes(), plan.model_dump_json())
"""


@dataclass(frozen=True)
class Planned:
    """A plan, and what making it took in a process of its own: processor time and memory."""

    plan: LogPlan
    seconds: float
    peak_bytes: int


def planned(folder: Path) -> Planned:
    """Plan the one log of a folder in a process of its own, with 4 GiB of addresses."""
    said = subprocess.run(
        [sys.executable, "-c", PLAN_IT, str(folder), str(4096 * MIB)],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert said.returncode == 0, said.stderr[-2000:]
    seconds, peak_bytes, plan = said.stdout.split(" ", 2)
    return Planned(LogPlan.model_validate_json(plan), float(seconds), int(peak_bytes))


def healthy_chunks(seconds: int = 4) -> list[Chunk]:
    """Clouds of a lidar at 10 Hz, one second of them in a chunk."""
    return [
        chunk_of(
            (1, time_ns, ring(time_ns))
            for each in range(10)
            for time_ns in [BEGIN_NS + second * NS_PER_S + each * NS_PER_S // 10]
        )
        for second in range(seconds)
    ]


def chunks_that_grow(path: Path) -> None:
    """Chunks of 120 MiB of zeros each, all of which may hold the lidar's first cloud."""
    grown = Chunk(message(1, BEGIN_NS, bytes(120 * MIB)), 0, BEGIN_NS, {1: 1})
    RawLog().write(path, [grown] * 40)


def chunks_that_say_they_grow_further(path: Path) -> None:
    """Chunks of a gigabyte, and ten topics that each ask for them."""
    grown = Chunk(message(1, BEGIN_NS, bytes(1000 * MIB)), 0, 0, dict.fromkeys(range(1, 11), 1))
    RawLog([f"/lidar/{each}" for each in range(10)]).write(path, [grown] * 4)


def messages_without_payload(path: Path) -> None:
    """Half a million messages of nothing in each of many chunks, all at once."""
    chunk = Chunk(empty_messages(450_000, step_ns=0), 0, BEGIN_NS, {1: 1})
    RawLog().write(path, [chunk] * 30)


def too_many_messages(path: Path) -> None:
    """More messages in one chunk than any has."""
    chunk = Chunk(empty_messages(3_000_000, step_ns=0), 0, BEGIN_NS, {1: 1})
    RawLog().write(path, [chunk] * 4)


def messages_far_apart(path: Path) -> None:
    """Messages in truth 10 s apart, for eleven days, in a chunk that every shard would read."""
    chunk = Chunk(
        empty_messages(100_000, step_ns=10 * NS_PER_S),
        BEGIN_NS,
        BEGIN_NS + 1_000_000 * NS_PER_S,
        {1: 100_000},
    )
    RawLog().write(path, [*healthy_chunks(), chunk])


def times_that_lie(path: Path) -> None:
    """An index by which each chunk holds half a million messages and lasts for 46 days."""
    chunks = [
        Chunk(each.records, each.start_ns, each.end_ns + 4 * 10**15, {1: 500_000})
        for each in healthy_chunks(3)
    ]
    RawLog().write(path, chunks)


def one_schema_of_many_channels(path: Path) -> None:
    """A schema of 700 kB that 60,000 channels share: 56 GB if each had its own."""
    schema = record(3, struct.pack("<H", 1) + text("big") + text("x") + text(bytes(700_000)))
    channels = b"".join(
        record(4, struct.pack("<HH", each, 1) + text(f"/t{each}") + text("cdr") + text(b""))
        for each in range(2, 60_000)
    )
    log = RawLog()
    log._head = schema + channels
    log.write(path, healthy_chunks(1))


def an_index_of_chunks_without_end(path: Path) -> None:
    """A summary that names the same bytes as 1.2 million chunks, each with its channels."""
    chunk = healthy_chunks(1)[0]
    entry = b"".join(struct.pack("<HQ", channel, 100) for channel in range(1, 4))
    entries = b"".join(
        record(
            8,
            struct.pack("<QQQQ", BEGIN_NS, BEGIN_NS, 100 + number % 5000, 60)
            + text(entry)
            + struct.pack("<Q", 0)
            + text("zstd")
            + struct.pack("<QQ", 0, 0),
        )
        for number in range(5000)
    )
    log = RawLog()
    log.write(path, [chunk])
    data = path.read_bytes()
    footer = len(data) - len(b"\x89MCAP0\r\n") - 29
    path.write_bytes(data[:footer] + entries * 160 + data[footer:])


def bytes_that_look_like_records(path: Path) -> None:
    """A log without an index of which every few bytes might begin a message."""
    RawLog().write(path, healthy_chunks(1), closed=False)
    with path.open("ab") as log:
        log.write(struct.pack("<BQ", 5, 22) + bytes(22) + b"\x00")
        log.write(struct.pack("<BQ", 5, 1) * (8 * MIB // 9))


HOSTILE: dict[str, Callable[[Path], None]] = {
    each.__name__: each
    for each in (
        chunks_that_grow,
        chunks_that_say_they_grow_further,
        messages_without_payload,
        too_many_messages,
        messages_far_apart,
        times_that_lie,
        one_schema_of_many_channels,
        an_index_of_chunks_without_end,
        bytes_that_look_like_records,
    )
}


@pytest.fixture(params=HOSTILE)
def hostile(request: pytest.FixtureRequest, tmp_path: Path) -> Planned:
    HOSTILE[request.param](tmp_path / "a.mcap")
    return planned(tmp_path)


def test_planning_stays_small_and_quick(hostile: Planned) -> None:
    plan = hostile.plan
    assert hostile.peak_bytes < MOST_MEMORY
    assert hostile.seconds < MOST_SECONDS
    if not (plan.refused or plan.damage):  # then the lie was seen through
        assert len(plan.shards) == 1
    assert len(json.dumps(plan.model_dump(mode="json"))) < MAX_PLAN_BYTES


READ_IT = """
import sys
from schemas.transport.bucket import open_bucket
from tests.tiny_logs import only_recording, settings
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.memory import peak_memory_bytes

bucket = open_bucket(sys.argv[1])
recording = only_recording(bucket)
frames = damaged = 0
for shard in plan_recording(bucket, recording, settings()).shards:
    reader = read_shard(bucket, recording, shard, settings())
    frames += sum(1 for _ in reader.frames())
    damaged += len(reader.damage)
print(frames, damaged, peak_memory_bytes())
"""


def test_reading_a_shard_of_chunks_that_grow_stays_small(tmp_path: Path) -> None:
    """Their messages are from the end of the shard: all would have to wait for the last chunk."""
    healthy = healthy_chunks()
    late_ns = healthy[-1].end_ns
    grown = Chunk(
        message(1, late_ns, bytes(50 * MIB)) + message(1, late_ns, bytes(50 * MIB)),
        BEGIN_NS,
        late_ns,
        {1: 2},
    )
    RawLog().write(tmp_path / "a.mcap", [healthy[0], *[grown] * 12, *healthy[1:]])
    said = subprocess.run(
        [sys.executable, "-c", READ_IT, str(tmp_path)],
        cwd=Path(__file__).parents[3],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    ).stdout.split()
    frames, damage, peak_bytes = (int(each) for each in said)
    assert frames >= 40
    assert damage == 0 or frames == 40
    assert peak_bytes < 520 * MIB
