"""Planning finds the lidars of a log and cuts it into shards that read little beyond their need."""

from dataclasses import replace

import numpy as np
import pytest
from mcap.writer import CompressionType

from schemas.arrays import NS_PER_S
from schemas.errors import ObjectChangedError
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.recordings import group_recordings
from schemas.work import LogPlan, Shard
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
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard

FRAME_BYTES = 14_100


def bucket_with(*parts: bytes, name: str = "car-7/2024-05-01/drive") -> Bucket:
    bucket = open_bucket("memory://")
    for number, part in enumerate(parts):
        bucket.put(f"{name}_{number}.mcap", part)
    return bucket


def planned(*parts: bytes, using: MiningSettings | None = None) -> LogPlan:
    bucket = bucket_with(*parts)
    return plan_recording(bucket, only_recording(bucket), using or settings())


def recorder(frames_per_chunk: int = 2) -> Recorder:
    return Recorder(chunk_bytes=frames_per_chunk * FRAME_BYTES - 5000)


def late(messages: list[Said], *, least_ms: int, most_ms: int) -> list[Said]:
    """The same messages, recorded a random while after their stamps."""
    delays_ms = np.random.default_rng(7).integers(least_ms, most_ms, len(messages))
    return [
        replace(said, log_time_ns=said.log_time_ns + int(delay_ms) * 1_000_000)
        for said, delay_ms in zip(messages, delays_ms, strict=True)
    ]


def scored(shard: Shard, stamp_ns: int) -> bool:
    return (shard.first_of_log or stamp_ns >= shard.start_ns) and (
        shard.last_of_log or stamp_ns < shard.end_ns
    )


def test_a_log_is_cut_into_shards_from_its_first_stamp() -> None:
    plan = planned(recorder().write(drive(50, delay_ns=30_000_000)))
    assert plan.refused == ""
    assert plan.lidar_topics == (LIDAR,)
    assert (plan.vehicle, plan.date) == ("car-7", "2024-05-01")
    assert [shard.name for shard in plan.shards] == [
        "lidar.points-00000",
        "lidar.points-00001",
        "lidar.points-00002",
    ]
    assert {shard.anchor_ns for shard in plan.shards} == {BEGIN_NS}
    assert [(shard.start_ns - BEGIN_NS) / NS_PER_S for shard in plan.shards] == [0, 20, 40]
    assert plan.shards[1].warmup_start_ns == plan.shards[1].start_ns - 1_200_000_000


def test_the_plan_of_a_log_is_the_same_every_time() -> None:
    data = recorder().write(late(drive(45), least_ms=20, most_ms=90))
    assert planned(data) == planned(data)


def test_planning_reads_the_index_and_one_chunk() -> None:
    noise = np.random.default_rng(3)
    messages = [
        Said(LIDAR, said.log_time_ns, said.data + noise.bytes(60_000)) for said in drive(30)
    ]
    data = Recorder(chunk_bytes=100_000, metadata={"counterpoint.log": {"vehicle": "v"}}).write(
        messages
    )
    plan = planned(data)
    assert plan.vehicle == "v"
    assert plan.range_reads == 3
    assert plan.bytes_read < 1_300_000


@pytest.mark.parametrize("frames_per_chunk", [2, 8])
@pytest.mark.parametrize(
    "delays_ms",
    [
        pytest.param((0, 1), id="recorded at the stamp"),
        pytest.param((100, 101), id="recorded a sweep later"),
        pytest.param((60, 140), id="recorded with jitter"),
    ],
)
def test_shards_read_at_most_a_tenth_more_than_they_need_and_lose_no_frame(
    frames_per_chunk: int, delays_ms: tuple[int, int]
) -> None:
    messages = late(drive(62), least_ms=delays_ms[0], most_ms=delays_ms[1])
    bucket = bucket_with(recorder(frames_per_chunk).write(messages))
    recording, using = only_recording(bucket), settings()
    plan = plan_recording(bucket, recording, using)
    read_bytes, stamps = 0, []
    for shard in plan.shards:
        reader = read_shard(bucket, recording, shard, using)
        stamps += [frame.stamp_ns for frame in reader.frames() if scored(shard, frame.stamp_ns)]
        read_bytes += reader.bytes_read
    assert stamps == [BEGIN_NS + number * 10**8 for number in range(620)]
    assert read_bytes <= 1.1 * sum(shard.needed_bytes for shard in plan.shards)


def test_needed_bytes_are_those_of_the_window_without_warm_up() -> None:
    data = Recorder(chunk_bytes=10, compression=CompressionType.NONE).write(drive(50))
    shard = planned(data).shards[1]
    one_chunk = shard.chunks[0].length
    assert {ref.length for ref in shard.chunks} == {one_chunk}
    assert shard.needed_bytes == 200 * one_chunk
    assert len(shard.chunks) == 212


def test_a_second_lidar_has_shards_of_its_own_on_the_same_grid() -> None:
    other = drive(25, begin_ns=BEGIN_NS + 40_000_000, topic="/rear/points")
    messages = sorted([*drive(25), *other], key=lambda said: said.log_time_ns)
    plan = planned(recorder(4).write(messages))
    assert plan.lidar_topics == (LIDAR, "/rear/points")
    assert [shard.name for shard in plan.shards] == [
        "lidar.points-00000",
        "lidar.points-00001",
        "rear.points-00000",
        "rear.points-00001",
    ]
    assert {shard.anchor_ns for shard in plan.shards} == {BEGIN_NS}


def test_a_configured_topic_is_mined_alone_whatever_it_looks_like() -> None:
    few = cloud(BEGIN_NS, np.ones((5, 3), dtype="<f4").tobytes(), ("x", "y", "z"))
    messages = [*drive(3), Said("/radar", BEGIN_NS + 3 * NS_PER_S, few)]
    data = recorder().write(messages)
    assert planned(data).lidar_topics == (LIDAR,)
    wanted = settings().model_copy(update={"lidar_topic": "/radar"})
    assert planned(data, using=wanted).lidar_topics == ("/radar",)
    wanted = settings().model_copy(update={"lidar_topic": "/roof"})
    assert planned(data, using=wanted).refused == (
        "no point clouds on the configured lidar topic /roof; topics are /lidar/points, /radar"
    )


@pytest.mark.parametrize(
    ("using", "says"),
    [
        pytest.param(
            {"schema_name": "sensor_msgs/msg/Imu"},
            "no lidar in the log: no topic holds point clouds; topics are /lidar/points",
            id="no clouds",
        ),
        pytest.param(
            {"schema_name": "foxglove.CompressedPointCloud", "message_encoding": "protobuf"},
            "/lidar/points needs a decoder for compressed clouds",
            id="Draco",
        ),
        pytest.param(
            {"schema_name": "velodyne_msgs/msg/VelodyneScan"},
            "/lidar/points holds Velodyne packets",
            id="packets",
        ),
    ],
)
def test_a_log_without_a_lidar_is_refused_by_the_names_of_its_topics(
    using: dict[str, str], says: str
) -> None:
    plan = planned(replace(recorder(), **using).write(drive(1)))  # type: ignore[arg-type]
    assert says in plan.refused
    assert plan.shards == ()


def test_a_log_without_any_message_is_refused() -> None:
    assert planned(recorder().write([])).refused.endswith("there are no topics")


def test_clouds_that_are_no_lidar_are_refused_with_the_reason() -> None:
    few = cloud(BEGIN_NS, np.ones((5, 3), dtype="<f4").tobytes(), ("x", "y", "z"))
    plan = planned(recorder().write([Said("/radar", BEGIN_NS, few)]))
    assert "/radar: its clouds have only 5 valid points" in plan.refused
    assert "lidar_topic" in plan.refused


def test_a_lidar_that_begins_with_empty_clouds_is_found_further_on() -> None:
    messages = drive(4)
    empty = [
        replace(said, data=cloud(said.log_time_ns, b"", ("x", "y", "z"))) for said in messages[:6]
    ]
    assert planned(recorder().write([*empty, *messages[6:]])).lidar_topics == (LIDAR,)


def test_a_file_that_is_no_log_is_refused() -> None:
    assert "no MCAP file" in planned(b"#ROSBAG V2.0\n" + bytes(100)).refused


def test_parts_that_name_different_vehicles_are_refused() -> None:
    parts = [
        replace(recorder(), metadata={"counterpoint.log": {"vehicle": name}}).write(
            drive(1, begin_ns=BEGIN_NS + number * NS_PER_S)
        )
        for number, name in enumerate(("car-7", "car-8"))
    ]
    plan = planned(*parts)
    assert plan.refused.startswith("the parts of the recording name different vehicles")
    assert plan.shards == ()


def test_split_recordings_are_planned_as_one_log() -> None:
    data = [
        recorder().write(drive(15, begin_ns=BEGIN_NS + number * 15 * NS_PER_S))
        for number in range(3)
    ]
    plan = planned(*data)
    assert plan.log_id == "car-7/2024-05-01/drive"
    assert [sorted({ref.part for ref in shard.chunks}) for shard in plan.shards] == [
        [0, 1],
        [1, 2],
        [2],
    ]


def test_a_part_that_is_no_log_costs_itself() -> None:
    plan = planned(recorder().write(drive(5)), b"", recorder().write(drive(3)))
    assert plan.refused == ""
    assert len(plan.shards) == 1
    (damage,) = plan.damage
    assert damage.key == "car-7/2024-05-01/drive_1.mcap"
    assert "the file is empty" in damage.what


def test_a_silent_stretch_has_no_shards() -> None:
    plan = planned(recorder().write(drive(90, silent=[(25, 65)])))
    assert [shard.index for shard in plan.shards] == [0, 1, 3, 4]
    assert plan.shards[2].before_lookahead_end_ns == 0


def test_clocks_that_drift_apart_lose_no_frame() -> None:
    drifting = [
        replace(said, log_time_ns=said.log_time_ns + number * 800_000)
        for number, said in enumerate(drive(62))
    ]
    bucket = bucket_with(recorder().write(drifting))
    recording, using = only_recording(bucket), settings()
    plan = plan_recording(bucket, recording, using)
    stamps = [
        frame.stamp_ns
        for shard in plan.shards
        for frame in read_shard(bucket, recording, shard, using).frames()
        if scored(shard, frame.stamp_ns)
    ]
    assert len(stamps) == 620


def test_a_sensor_clock_that_jumps_makes_log_time_the_frame_time() -> None:
    boot_ns = 50 * NS_PER_S
    messages = [
        Said(LIDAR, said.log_time_ns + 5_000_000, ring(boot_ns + number * 10**8))
        if number < 100
        else replace(said, log_time_ns=said.log_time_ns + 5_000_000)
        for number, said in enumerate(drive(60))
    ]
    bucket = bucket_with(recorder().write(messages))
    recording, using = only_recording(bucket), settings()
    plan = plan_recording(bucket, recording, using)
    assert all(shard.by_log_time for shard in plan.shards)
    stamps = [
        frame.stamp_ns
        for shard in plan.shards
        for frame in read_shard(bucket, recording, shard, using).frames()
        if scored(shard, frame.stamp_ns)
    ]
    assert stamps == [said.log_time_ns for said in messages]


def test_a_chunk_whose_index_lies_about_its_times_is_opened() -> None:
    bucket = bucket_with(recorder().write(drive(30)))
    recording = only_recording(bucket)
    honest = plan_recording(bucket, recording, settings())
    lying = bytearray(bucket.read_all(recording.parts[0].key))
    lying[-12:-8] = bytes(4)  # no checksum guards the summary any more
    end_ns = (BEGIN_NS + 14 * 10**8 + 10**8).to_bytes(8, "little")
    while (place := lying.rfind(end_ns)) >= 0:
        lying[place : place + 8] = (BEGIN_NS + 90_000 * NS_PER_S).to_bytes(8, "little")
    plan = planned(bytes(lying))
    assert [shard.index for shard in plan.shards] == [shard.index for shard in honest.shards]


def test_a_damaged_first_chunk_does_not_hide_the_lidar() -> None:
    data = bytearray(recorder().write(drive(5)))
    plan = planned(bytes(data))
    first = plan.shards[0].chunks[0]
    data[first.offset + first.length - 5] ^= 255
    hurt = planned(bytes(data))
    assert hurt.lidar_topics == (LIDAR,)
    assert hurt.damage == ()  # the shard that reads the chunk reports it
    assert hurt.shards[0].anchor_ns > plan.shards[0].anchor_ns


def test_a_log_of_which_no_chunk_can_be_read_is_refused_with_its_damage() -> None:
    data = bytearray(recorder().write(drive(2)))
    for ref in planned(bytes(data)).shards[0].chunks:
        data[ref.offset + ref.length - 5] ^= 255
    plan = planned(bytes(data))
    assert (
        plan.refused
        == "no lidar in the log: no cloud of /lidar/points can be read (10 damaged chunks)"
    )
    assert len(plan.damage) == 10


def test_a_log_that_is_replaced_while_it_is_planned_is_not_mixed() -> None:
    bucket = bucket_with(recorder().write(drive(3)))
    (recording,) = group_recordings(bucket.list())
    bucket.put(recording.parts[0].key, recorder().write(drive(4)))
    with pytest.raises(ObjectChangedError):
        plan_recording(bucket, recording, settings())
