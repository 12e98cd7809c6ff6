"""Clouds of several lidars of one car become one frame, or the log is refused in one sentence."""

from collections.abc import Sequence
from io import BytesIO

import numpy as np
import pytest
from mcap_ros2.writer import Writer

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.work import LogPlan
from tests.tiny_logs import BEGIN_NS, only_recording, settings
from workers.ingest.plan import plan_recording
from workers.ingest.read import ShardReader, read_shard
from workers.lab.simulation.output.cloud import (
    POINT_CLOUD2,
    POINT_CLOUD2_DEFINITION,
    message_of,
)
from workers.lab.simulation.output.static_spaces import (
    TF_DEFINITION,
    TF_MESSAGE,
    TF_STATIC_TOPIC,
    static_message,
)

ROOF, FRONT, CLASSES = "/roof/points", "/front/points", "counterpoint.classes"
PERIOD_NS = NS_PER_S // 10
LATE_NS = 30_000_000

MOUNTED_M = np.array([2.0, 0.0, -1.0])


def placed(x: float, z: float, *, turned: bool = False) -> np.ndarray:
    pose = np.eye(4)
    if turned:
        pose[:2, :2] = [[0, -1], [1, 0]]
    pose[:3, 3] = x, 0.0, z
    return pose


def rows(count: int, *, x_m: float, label: int | None = None) -> np.ndarray:
    """Return points in a circle, so that a lidar is seen all around; the first one is at x."""
    named = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2")]
    named += [("label", "<u2"), ("motion", "<u1")] if label is not None else []
    made = np.zeros(count, np.dtype(named))
    angle = np.arange(count) * 2 * np.pi / count
    made["x"], made["y"] = x_m * np.cos(angle), x_m * np.sin(angle)
    made["z"], made["ring"] = np.resize(np.linspace(-2, 2, 8), count), np.arange(count) % 8
    if label is not None:
        made["label"], made["motion"] = label, 1
    return made


def log(
    *,
    seconds: float = 2.0,
    front_at: Sequence[int] | None = None,
    clock_ns: int = 0,
    with_transforms: bool = True,
    labels: tuple[int | None, int | None] = (None, None),
) -> bytes:
    """Write a roof lidar and one in front, which is turned and fires 30 ms later."""
    out = BytesIO()
    writer = Writer(out, chunk_size=40_000)
    schema = writer.register_msgdef(POINT_CLOUD2, POINT_CLOUD2_DEFINITION)
    if with_transforms:
        places = {"roof": placed(0.0, 2.0), "front": placed(2.0, 1.0, turned=True)}
        tf = writer.register_msgdef(TF_MESSAGE, TF_DEFINITION)
        message = static_message(places, stamp_ns=BEGIN_NS)
        writer.write_message(TF_STATIC_TOPIC, tf, message, BEGIN_NS, BEGIN_NS)
    if any(label is not None for label in labels):
        writer.add_metadata(CLASSES, {"3": '{"name": "car", "movable": true, "moving": false}'})
    for number in range(round(seconds * NS_PER_S) // PERIOD_NS):
        stamp_ns = BEGIN_NS + number * PERIOD_NS
        roof = message_of(rows(900, x_m=10.0, label=labels[0]), stamp_ns=stamp_ns, space="roof")
        writer.write_message(ROOF, schema, roof, stamp_ns, stamp_ns)
        if front_at is None or number in front_at:
            late_ns = stamp_ns + LATE_NS
            cloud = rows(100 + number, x_m=5.0, label=labels[1])
            front = message_of(cloud, stamp_ns=late_ns + clock_ns, space="front")
            writer.write_message(FRONT, schema, front, late_ns, late_ns)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def plan(data: bytes, **changes: str) -> tuple[LogPlan, ShardReader | None]:
    bucket = open_bucket("memory://")
    bucket.put("drive.mcap", data)
    recording = only_recording(bucket)
    chosen = {"lidar_topic": f"{ROOF},{FRONT}"} | changes
    using: MiningSettings = settings().model_copy(update=chosen)
    made = plan_recording(bucket, recording, using)
    if not made.shards:
        return made, None
    return made, read_shard(bucket, recording, made.shards[0], using)


def frames(data: bytes, **changes: str) -> tuple[list[LidarFrame], list[str]]:
    made, reader = plan(data, **changes)
    assert reader is not None, made.refused
    found = list(reader.frames())
    return found, [each.what for each in reader.damage]


def test_points_of_the_further_lidar_follow_in_the_space_of_the_main_one() -> None:
    found, damage = frames(log())
    assert len(found) == 20
    assert damage == []
    for number, frame in enumerate(found):
        (front,) = frame.joined
        assert (frame.main_points, front.points, front.topic) == (900, 100 + number, FRONT)
        assert front.stamp_ns == frame.stamp_ns + LATE_NS
        # its first point lies 5 m ahead of a lidar that looks to the left
        np.testing.assert_allclose(frame.points_m[900], MOUNTED_M + np.array([0, 5, -2]), atol=1e-5)
        assert (frame.offset_ns[900:] == LATE_NS).all()
        assert (frame.offset_ns[:900] == 0).all()


def test_the_main_part_is_the_frame_that_one_lidar_gives() -> None:
    joined, _ = frames(log())
    alone, _ = frames(log(), lidar_topic=ROOF)
    for whole, one in zip(joined, alone, strict=True):
        main = whole.main()
        assert main.joined == ()
        assert main.stamp_ns == one.stamp_ns
        np.testing.assert_array_equal(main.points_m, one.points_m)
        np.testing.assert_array_equal(main.ring, one.ring)
        np.testing.assert_array_equal(main.intensity, one.intensity)


def test_a_silent_lidar_is_said_and_the_frame_is_mined_without_it() -> None:
    found, damage = frames(log(front_at=range(5, 20)))
    assert [frame.joined[0].points > 0 for frame in found] == [False] * 5 + [True] * 15
    assert damage == [
        "the lidar /front/points has no cloud within 50 ms of 5 of 20 frames: they were mined "
        "without it"
    ]


@pytest.mark.parametrize("shard_s", [2.0, 4.0, 20.0])
def test_frames_are_the_same_however_the_log_is_cut(shard_s: float) -> None:
    bucket = open_bucket("memory://")
    bucket.put("drive.mcap", log(seconds=6.0))
    recording = only_recording(bucket)
    using = settings().model_copy(update={"lidar_topic": f"{ROOF},{FRONT}"})
    using = using.model_copy(update={"grid": using.grid.model_copy(update={"shard_s": shard_s})})
    made = plan_recording(bucket, recording, using)
    points = {}
    for shard in made.shards:
        for frame in read_shard(bucket, recording, shard, using).frames():
            if shard.start_ns <= frame.stamp_ns < shard.end_ns:
                points[frame.stamp_ns] = len(frame)
    assert list(points.values()) == [1000 + number for number in range(60)]


def test_labels_of_each_lidar_are_joined() -> None:
    found, _ = frames(log(labels=(3, 3)), supervised="recorded")
    for frame in found:
        assert frame.recorded is not None
        assert frame.recorded.motion is not None
        assert (frame.recorded.class_id == 3).all()
        assert (frame.recorded.motion == 1).all()


def test_points_without_labels_of_their_lidar_have_no_answer() -> None:
    found, _ = frames(log(labels=(3, None)), supervised="recorded")
    for frame in found:
        assert frame.recorded is not None
        assert frame.recorded.motion is not None
        assert (frame.recorded.motion[:900] == 1).all()
        assert (frame.recorded.motion[900:] == 0).all()
        assert set(frame.recorded.class_id[900:]).isdisjoint(frame.recorded.classes)


def test_a_named_topic_that_the_log_lacks_is_refused() -> None:
    made, _ = plan(log(), lidar_topic=f"{ROOF},/rear/points")
    assert "no point clouds on the configured lidar topic /rear/points" in made.refused


def test_a_lidar_that_no_transform_places_is_refused() -> None:
    made, _ = plan(log(with_transforms=False))
    assert made.refused.startswith(
        "no transform from 'front' to 'roof' on a topic tf_static: /front/points cannot be joined"
    )


def test_clocks_that_are_apart_are_refused() -> None:
    made, _ = plan(log(clock_ns=37 * NS_PER_S))
    assert "the clocks of /roof/points and /front/points are 37.0 s apart" in made.refused


def test_one_topic_plans_the_same_bytes_as_before() -> None:
    made, _ = plan(log(), lidar_topic=ROOF)
    assert b"further" not in made.model_dump_json().encode()


@pytest.mark.parametrize(
    "value", ["/a,", ",", "/a,,/b", "/a,/a", ",".join(f"/{n}" for n in range(9))]
)
def test_a_list_of_topics_is_checked(value: str) -> None:
    with pytest.raises(ValueError, match="lidar_topic"):
        MiningSettings(bucket="memory://", artifacts="memory://", lidar_topic=value)


def test_a_list_may_have_spaces() -> None:
    made = MiningSettings(bucket="memory://", artifacts="memory://", lidar_topic="/a, /b")
    assert made.lidar_names == ("/a", "/b")
