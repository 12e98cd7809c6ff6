"""Frames of a shard come in order, whole, and from the objects that were planned."""

import tracemalloc
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from mcap.writer import CompressionType

from schemas.arrays import NS_PER_S
from schemas.errors import ObjectChangedError
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket, open_bucket
from schemas.work import ChunkRef, LogPlan, Recording
from tests.tiny_logs import (
    BEGIN_NS,
    LIDAR,
    Recorder,
    Said,
    cloud,
    drive,
    only_recording,
    ring,
    settings,
)
from workers.ingest import read as read_module
from workers.ingest.fetch import MAX_BETWEEN_BYTES, MAX_READ_BYTES, neighbours
from workers.ingest.plan import plan_recording
from workers.ingest.read import ShardReader, read_shard

RECORDER = Recorder(chunk_bytes=30_000)
LABELS = "/lidar/labels"
CLASSES = {"counterpoint.classes": {"3": '{"name": "car", "movable": true, "moving": false}'}}


class Log:
    """A log in a bucket, planned."""

    def __init__(self, *parts: bytes, using: MiningSettings | None = None) -> None:
        self.bucket: Bucket = open_bucket("memory://")
        for number, part in enumerate(parts):
            self.bucket.put(f"drive_{number}.mcap", part)
        self.recording: Recording = only_recording(self.bucket)
        self.settings = using or settings()
        self.plan: LogPlan = plan_recording(self.bucket, self.recording, self.settings)

    def reader(self, shard: int = 0) -> ShardReader:
        return read_shard(self.bucket, self.recording, self.plan.shards[shard], self.settings)

    def stamps_s(self, shard: int = 0) -> list[float]:
        return [
            round((frame.stamp_ns - BEGIN_NS) / NS_PER_S, 3)
            for frame in self.reader(shard).frames()
        ]


def shuffled(messages: Sequence[Said], order: Sequence[int]) -> list[Said]:
    return [messages[number] for number in order]


def test_frames_come_with_warm_up_and_window_in_order() -> None:
    log = Log(RECORDER.write(drive(50)))
    assert log.stamps_s(0) == [number / 10 for number in range(200)]
    assert log.stamps_s(1) == [number / 10 for number in range(188, 400)]


def test_a_frame_is_what_was_recorded() -> None:
    (frame, *_) = Log(RECORDER.write(drive(3))).reader().frames()
    assert frame.log_id == "drive"
    assert len(frame) == 864
    assert frame.valid_mask.all()
    np.testing.assert_allclose(np.linalg.norm(frame.points_m, axis=1), 10, rtol=1e-5)


def test_messages_written_out_of_order_come_by_log_time() -> None:
    messages = drive(2)
    order = [3, 0, 1, 2, 7, 9, 8, 4, 5, 6, *range(19, 9, -1)]
    log = Log(RECORDER.write(shuffled(messages, order)))
    assert log.stamps_s() == [number / 10 for number in range(20)]


def test_parts_that_overlap_in_time_are_merged() -> None:
    messages = drive(4)
    log = Log(RECORDER.write(messages[::2]), RECORDER.write(messages[1::2]))
    assert log.stamps_s() == [number / 10 for number in range(40)]


def test_too_much_disorder_costs_order_not_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(read_module, "MAX_WAITING_BYTES", 60_000)
    messages = drive(3)
    order = [29, *range(29)]
    log = Log(Recorder(chunk_bytes=20_000).write(shuffled(messages, order)))
    assert sorted(log.stamps_s()) == [number / 10 for number in range(30)]


def test_a_shard_knows_what_reading_it_cost() -> None:
    log = Log(Recorder(chunk_bytes=10, compression=CompressionType.NONE).write(drive(50)))
    reader = log.reader(1)
    frames = list(reader.frames())
    assert len(frames) == 212
    # Fetched together, the chunks bring along the message indexes between them.
    assert reader.bytes_read == pytest.approx(sum(c.length for c in reader.shard.chunks), rel=0.01)
    assert reader.range_reads == 1
    assert reader.damage == []


def test_a_damaged_chunk_costs_its_own_frames_only() -> None:
    data = bytearray(RECORDER.write(drive(5)))
    victim = Log(bytes(data)).plan.shards[0].chunks[3]
    data[victim.offset + victim.length - 5] ^= 255
    log = Log(bytes(data))
    reader = log.reader()
    stamps = [frame.stamp_ns for frame in reader.frames()]
    lost = {said.log_time_ns for said in drive(5)} - set(stamps)
    assert len(stamps) == 47
    assert min(lost) == victim.start_ns
    assert max(lost) == victim.end_ns
    (damage,) = reader.damage
    assert (damage.key, damage.offset, damage.bytes) == (
        "drive_0.mcap",
        victim.offset,
        victim.length,
    )


def test_a_cloud_that_is_none_costs_itself() -> None:
    messages = drive(3)
    messages[10] = replace(messages[10], data=messages[10].data[:500])
    log = Log(RECORDER.write(messages))
    reader = log.reader()
    assert len(list(reader.frames())) == 29
    (damage,) = reader.damage
    assert damage.bytes == 500
    assert LIDAR in damage.what


def test_a_log_that_is_replaced_while_it_is_mined_is_not_mixed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("workers.ingest.fetch.MAX_READ_BYTES", 10_000)
    log = Log(RECORDER.write(drive(10)))
    frames = log.reader().frames()
    first = next(frames)
    log.bucket.put("drive_0.mcap", RECORDER.write(drive(10)))
    with pytest.raises(ObjectChangedError) as caught:
        list(frames)
    assert first.stamp_ns == BEGIN_NS
    assert caught.value.key == "drive_0.mcap"


def test_messages_outside_chunks_are_read_in_runs() -> None:
    log = Log(replace(RECORDER, chunked=False).write(drive(25)))
    assert {ref.kind for ref in log.plan.shards[0].chunks} == {"records"}
    assert [at_s for at_s in log.stamps_s(0) if at_s < 20] == [n / 10 for n in range(200)]
    assert log.stamps_s(1) == [number / 10 for number in range(188, 250)]


def test_memory_holds_a_few_chunks_not_the_shard() -> None:
    noise = np.random.default_rng(0)
    messages = [
        Said(LIDAR, said.log_time_ns, said.data + noise.bytes(1_000_000)) for said in drive(3)
    ]
    log = Log(Recorder(chunk_bytes=2_000_000).write(messages))
    tracemalloc.start()
    try:
        count = sum(1 for _ in log.reader().frames())
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert count == 30
    assert peak < 45_000_000


def test_reading_may_end_early() -> None:
    frames = Log(RECORDER.write(drive(50))).reader().frames()
    assert next(frames).stamp_ns == BEGIN_NS
    frames.close()


def labels_cloud(stamp_ns: int, *, points: int = 864) -> bytes:
    rows = np.tile(np.array([1, 2, 3, 3, 2], dtype="<f4"), (points, 1))
    return cloud(stamp_ns, rows.tobytes(), ("x", "y", "z", "label", "motion"))


@pytest.mark.parametrize("delay_s", [-0.05, 0.0, 0.25])
def test_recorded_labels_of_a_topic_of_their_own_reach_their_frames(delay_s: float) -> None:
    lidar = drive(24)
    said = [
        Said(LABELS, each.log_time_ns + round(delay_s * NS_PER_S), labels_cloud(each.log_time_ns))
        for each in lidar
    ]
    messages = sorted([*lidar, *said], key=lambda each: each.log_time_ns)
    recorder = replace(RECORDER, metadata=CLASSES)
    log = Log(recorder.write(messages), using=settings(supervised="recorded"))
    assert log.plan.refused == ""
    assert log.plan.lidar_topics == (LIDAR,)
    for shard in log.plan.shards:
        for frame in read_shard(log.bucket, log.recording, shard, log.settings).frames():
            assert frame.recorded is not None
            assert frame.recorded.class_id.tolist() == [3] * 864
            assert frame.recorded.classes[3].name == "car"


def test_recorded_labels_may_be_fields_of_the_cloud() -> None:
    messages = []
    for said in drive(3):
        rows = np.frombuffer(ring(0)[-864 * 16 - 1 : -1], dtype="<f4").reshape(-1, 4)
        labelled = np.hstack([rows, np.full((864, 1), 3, dtype="<f4")])
        fields = ("x", "y", "z", "intensity", "label")
        messages.append(replace(said, data=cloud(said.log_time_ns, labelled.tobytes(), fields)))
    recorder = replace(RECORDER, metadata=CLASSES)
    log = Log(recorder.write(messages), using=settings(supervised="recorded"))
    frames = list(log.reader().frames())
    assert len(frames) == 30
    assert all(each.recorded is not None for each in frames)


def test_a_log_without_recorded_labels_is_refused_when_they_are_wanted() -> None:
    log = Log(RECORDER.write(drive(3)), using=settings(supervised="recorded"))
    assert log.plan.refused.startswith("no recorded labels for /lidar/points")


def test_chunks_are_fetched_together_only_where_they_lie_together() -> None:
    def ref(offset: int, length: int, part: int = 0) -> ChunkRef:
        return ChunkRef(part=part, offset=offset, length=length, start_ns=0, end_ns=0)

    half = MAX_READ_BYTES // 2
    near, far = ref(150, 50), ref(200 + MAX_BETWEEN_BYTES + 1, 50)
    assert neighbours([ref(0, 100), near, far]) == [[ref(0, 100), near], [far]]
    assert len(neighbours([near, ref(0, 100)])) == 2
    assert len(neighbours([ref(0, 100), ref(100, 50, part=1)])) == 2
    assert [
        len(each) for each in neighbours([ref(0, half), ref(half, half), ref(2 * half, 1)])
    ] == [
        2,
        1,
    ]
    assert neighbours([]) == []


def test_times_that_no_clock_shows_are_damage() -> None:
    messages = drive(3)
    messages[7] = replace(messages[7], log_time_ns=2**63 + 5)
    messages[9] = replace(messages[9], log_time_ns=2**64 - 1)
    for recorder in (RECORDER, replace(RECORDER, chunked=False)):
        log = Log(recorder.write(messages))
        reader = log.reader()
        assert len(list(reader.frames())) == 28
        assert [damage.what for damage in reader.damage] == [
            "a message says that it was logged at 9223372036854775813 ns",
            "a message says that it was logged at 18446744073709551615 ns",
        ]
