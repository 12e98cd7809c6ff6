"""Whatever happens to the bytes of a log: no crash, and mining reads what verifying counts."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType

from schemas.errors import PermanentError
from schemas.transport.bucket import open_bucket
from tests.tiny_logs import Recorder, drive, only_recording, settings
from workers.ingest.inspect import inspect_recording
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard

CHUNKED = Recorder(chunk_bytes=30_000)
BARE = replace(
    CHUNKED,
    statistics=False,
    summary_offsets=False,
    repeat_channels=False,
    repeat_schemas=False,
    indexes=IndexType.NONE,
)
RECORDERS = (
    CHUNKED,
    replace(CHUNKED, compression=CompressionType.LZ4),
    replace(BARE, compression=CompressionType.NONE),
    replace(BARE, chunked=False),
)


def flip(data: bytearray, chance: np.random.Generator) -> None:
    for place in chance.integers(0, len(data), 8):
        data[place] ^= 1 << int(chance.integers(0, 8))


def cut(data: bytearray, chance: np.random.Generator) -> None:
    del data[chance.integers(0, len(data)) :]


def overwrite(data: bytearray, chance: np.random.Generator) -> None:
    place, length = chance.integers(0, len(data)), int(chance.integers(1, 5000))
    data[place : place + length] = bytes(min(length, len(data) - int(place)))


def remove(data: bytearray, chance: np.random.Generator) -> None:
    place = chance.integers(0, len(data))
    del data[place : place + chance.integers(1, 3000)]


def hurt_summary(data: bytearray, chance: np.random.Generator) -> None:
    data[-12:-8] = bytes(4)  # without its checksum the summary is believed
    for place in chance.integers(max(len(data) - 1500, 0), len(data) - 28, 4):
        data[place] = int(chance.integers(0, 256))


@pytest.mark.parametrize("damage", [flip, cut, overwrite, remove, hurt_summary])
@pytest.mark.parametrize("seed", range(8))
def test_no_damage_to_the_bytes_is_more_than_damage_to_the_log(
    damage: Callable[[bytearray, np.random.Generator], None], seed: int
) -> None:
    data = bytearray(RECORDERS[seed % len(RECORDERS)].write(drive(2)))
    damage(data, np.random.default_rng(seed))
    bucket = open_bucket("memory://")
    bucket.put("drive.mcap", bytes(data))
    recording, using = only_recording(bucket), settings(shard_s=2)
    try:
        report = inspect_recording(bucket, recording, using, verify=True)
    except PermanentError:
        return
    frames = 0
    for shard in plan_recording(bucket, recording, using).shards:
        for frame in read_shard(bucket, recording, shard, using).frames():
            frames += (shard.first_of_log or frame.stamp_ns >= shard.start_ns) and (
                shard.last_of_log or frame.stamp_ns < shard.end_ns
            )
    assert frames == (0 if report.refused else report.frames)
    assert frames <= 20
