"""What a log says of the car's motion reaches its frames, and reading it costs next to nothing."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from mcap_ros1._vendor.genpy import Time
from mcap_ros1._vendor.genpy.dynamic import generate_dynamic
from mcap_ros2._dynamic import serialize_dynamic

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, RecordedMotion
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.work import Damage, LogPlan
from tests.tiny_logs import BEGIN_NS, CLOUD_TYPE, LIDAR, Said, drive, only_recording, settings
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.ingest.ros_definitions import ROS1_DEFINITIONS, ROS2_DEFINITIONS

SPEED, TURN = 8.0, 0.2
ODOM = "/vehicle/odometry"
STAMP = "\n" + "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"

Kind = tuple[str, str, str]
"""Encoding of messages, name of their type, encoding of its schema."""

CLOUDS: Kind = ("cdr", CLOUD_TYPE, "ros2msg")
IMAGES: Kind = ("cdr", "sensor_msgs/msg/CompressedImage", "ros2msg")


@dataclass(frozen=True)
class Stated:
    """What one message of motion says."""

    stamp_ns: int
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    speed: float = 0.0
    turn: float = 0.0

    def pose(self) -> dict[str, Any]:
        half = self.yaw_rad / 2
        turned = {"x": 0.0, "y": 0.0, "z": float(np.sin(half)), "w": float(np.cos(half))}
        return {"position": {"x": self.x_m, "y": self.y_m, "z": 0.0}, "orientation": turned}

    def twist(self) -> dict[str, Any]:
        return {
            "linear": {"x": self.speed, "y": 0.0, "z": 0.0},
            "angular": {"x": 0.0, "y": 0.0, "z": self.turn},
        }

    def fields(self, name: str) -> dict[str, Any]:
        """All fields of a message, as ROS 2 writes it."""
        unknown = [0.0] * 36
        made: dict[str, Any] = {}
        if name == "nav_msgs/Odometry":
            made["child_frame_id"] = "base_link"
            made["pose"] = {"pose": self.pose(), "covariance": unknown}
        if "Covariance" in name or "pose" in made:
            return made | {"twist": {"twist": self.twist(), "covariance": unknown}}
        return made | {"twist": self.twist()}


def circling(seconds: float, *, rate_hz: float = 50.0, silent: str = "") -> list[Stated]:
    """A car on a circle; of `pose` and `twist` one may say nothing."""
    at_s = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    yaw = TURN * at_s
    x, y = SPEED / TURN * np.sin(yaw), SPEED / TURN * (1.0 - np.cos(yaw))
    stamps_ns = [BEGIN_NS + round(each * NS_PER_S) for each in at_s]
    if silent == "pose":
        return [Stated(at_ns, speed=SPEED, turn=TURN) for at_ns in stamps_ns]
    said = (0.0, 0.0) if silent == "twist" else (SPEED, TURN)
    return [
        Stated(at_ns, float(x[i]), float(y[i]), float(yaw[i]), *said)
        for i, at_ns in enumerate(stamps_ns)
    ]


def ros2(name: str) -> Callable[[Stated], bytes]:
    encode = serialize_dynamic(name, ROS2_DEFINITIONS[name] + STAMP)[name]

    def write(said: Stated) -> bytes:
        seconds, rest = divmod(said.stamp_ns, NS_PER_S)
        header = {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": "odom"}
        return bytes(encode({"header": header, **said.fields(name)}))

    return write


def ros1(name: str) -> Callable[[Stated], bytes]:
    types: Any = generate_dynamic(name, ROS1_DEFINITIONS[name])  # type: ignore[no-untyped-call]

    def fill(message: Any, fields: dict[str, Any]) -> None:
        for key, value in fields.items():
            if isinstance(value, dict):
                fill(getattr(message, key), value)
            else:
                setattr(message, key, value)

    def write(said: Stated) -> bytes:
        message = types[name]()
        message.header.stamp = Time(*divmod(said.stamp_ns, NS_PER_S))  # type: ignore[no-untyped-call]
        fill(message, said.fields(name))
        out = BytesIO()
        message.serialize(out)
        return out.getvalue()

    return write


def foxglove(said: Stated) -> bytes:
    seconds, rest = divmod(said.stamp_ns, NS_PER_S)
    stamp = {"sec": seconds, "nsec": rest}
    return json.dumps({"timestamp": stamp, "frame_id": "map", "pose": said.pose()}).encode()


def written(
    said: Sequence[tuple[Kind, Said]], *, chunk_bytes: int = 30_000, apart: bool = False
) -> bytes:
    """Write messages by log time; `apart`: the clouds first, in chunks of their own."""
    out = BytesIO()
    writer = Writer(out, chunk_size=chunk_bytes)
    writer.start(profile="", library="test")
    channels: dict[tuple[Kind, str], int] = {}
    kinds: dict[Kind, int] = {}
    for kind, each in sorted(
        said, key=lambda one: (apart and one[0] is not CLOUDS, one[1].log_time_ns)
    ):
        encoding, name, schema_encoding = kind
        if kind not in kinds:
            kinds[kind] = writer.register_schema(name, schema_encoding, b"")
        if (kind, each.topic) not in channels:
            channels[kind, each.topic] = writer.register_channel(
                topic=each.topic, message_encoding=encoding, schema_id=kinds[kind]
            )
        writer.add_message(
            channels[kind, each.topic], each.log_time_ns, each.data, publish_time=each.log_time_ns
        )
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def clouds(seconds: float) -> list[tuple[Kind, Said]]:
    return [(CLOUDS, each) for each in drive(seconds)]


def moved(
    kind: Kind,
    encode: Callable[[Stated], bytes],
    stated: Sequence[Stated],
    *,
    topic: str = ODOM,
    delay_ns: int = 0,
) -> list[tuple[Kind, Said]]:
    return [(kind, Said(topic, each.stamp_ns + delay_ns, encode(each))) for each in stated]


ODOMETRY: Kind = ("cdr", "nav_msgs/msg/Odometry", "ros2msg")
TWIST: Kind = ("cdr", "geometry_msgs/msg/TwistStamped", "ros2msg")


def said_by(
    data: bytes, using: MiningSettings | None = None
) -> tuple[LogPlan, list[LidarFrame], list[Damage]]:
    using = using or settings()
    bucket = open_bucket("memory://")
    bucket.put("drive.mcap", data)
    recording = only_recording(bucket)
    plan = plan_recording(bucket, recording, using)
    reader = read_shard(bucket, recording, plan.shards[0], using)
    return plan, list(reader.frames()), reader.damage


def check(frames: Sequence[LidarFrame]) -> None:
    assert frames[0].moved is None
    for frame in frames[1:]:
        assert frame.moved is not None
        assert frame.moved.speed_m_per_s == pytest.approx(SPEED, rel=1e-3)
        assert frame.moved.turn_rad_per_s == pytest.approx(TURN, rel=1e-3)


@pytest.mark.parametrize(
    ("kind", "encode", "silent"),
    [
        (ODOMETRY, ros2("nav_msgs/Odometry"), ""),
        (ODOMETRY, ros2("nav_msgs/Odometry"), "twist"),
        (("ros1", "nav_msgs/Odometry", "ros1msg"), ros1("nav_msgs/Odometry"), ""),
        (TWIST, ros2("geometry_msgs/TwistStamped"), "pose"),
        (
            ("ros1", "geometry_msgs/TwistWithCovarianceStamped", "ros1msg"),
            ros1("geometry_msgs/TwistWithCovarianceStamped"),
            "pose",
        ),
        (("json", "foxglove.PoseInFrame", "jsonschema"), foxglove, ""),
    ],
)
def test_frames_know_how_the_car_says_it_moved(
    kind: Kind, encode: Callable[[Stated], bytes], silent: str
) -> None:
    data = written([*clouds(3), *moved(kind, encode, circling(3.1, silent=silent))])
    plan, frames, damage = said_by(data)
    assert (plan.refused, len(frames), damage) == ("", 30, [])
    check(frames)


def test_without_such_a_topic_or_with_none_wanted_nothing_is_read_or_said() -> None:
    alone = written(clouds(3))
    both = written([*clouds(3), *moved(ODOMETRY, ros2("nav_msgs/Odometry"), circling(3))])
    for data, topic in ((alone, ""), (both, "none"), (both, "/other")):
        using = settings().model_copy(update={"odometry_topic": topic})
        plan, frames, _ = said_by(data, using)
        assert plan.shards[0].motion is None
        assert {frame.moved for frame in frames} == {None}


def test_odometry_goes_before_commands_unless_one_is_named() -> None:
    still = [Stated(each.stamp_ns, turn=1e-3) for each in circling(3)]
    data = written(
        [
            *clouds(3),
            *moved(TWIST, ros2("geometry_msgs/TwistStamped"), still, topic="/cmd_vel"),
            *moved(ODOMETRY, ros2("nav_msgs/Odometry"), circling(3)),
        ]
    )
    check(said_by(data)[1])
    named = said_by(data, settings().model_copy(update={"odometry_topic": "/cmd_vel"}))[1]
    assert named[9].moved == RecordedMotion(0.0, 1e-3)


def test_a_damaged_or_absurd_message_costs_itself_and_is_said_once() -> None:
    stated = circling(3)
    stated[20] = Stated(stated[20].stamp_ns, speed=1e9)
    stated[60] = Stated(stated[60].stamp_ns, speed=float("nan"))
    messages = moved(ODOMETRY, ros2("nav_msgs/Odometry"), stated)
    kind, cut = messages[90]
    messages[90] = kind, Said(cut.topic, cut.log_time_ns, cut.data[:40])
    stated_wrong = Stated(stated[100].stamp_ns, speed=60.0, turn=TURN)
    messages[100] = kind, Said(ODOM, stated_wrong.stamp_ns, ros2("nav_msgs/Odometry")(stated_wrong))
    _, frames, damage = said_by(written([*clouds(3), *messages]))
    check(frames)
    (said,) = damage
    assert "no motion of a car" in said.what


def test_a_silence_leaves_its_frames_without() -> None:
    stated = [each for each in circling(3) if not 1.0 < (each.stamp_ns - BEGIN_NS) / NS_PER_S < 2.0]
    messages = moved(ODOMETRY, ros2("nav_msgs/Odometry"), stated)
    _, frames, _ = said_by(written([*clouds(3), *messages]))
    assert [number for number, frame in enumerate(frames) if frame.moved is None] == [
        0,
        *range(11, 20),  # the last sample holds for the 50 ms of frame 10 that lie after it
    ]


def test_a_clock_of_its_own_is_brought_to_the_lidars_by_log_times() -> None:
    leap_ns = 37 * NS_PER_S
    ahead = [
        Stated(each.stamp_ns + leap_ns, speed=float(i), turn=TURN)
        for i, each in enumerate(circling(3, rate_hz=10.0))
    ]
    messages = moved(ODOMETRY, ros2("nav_msgs/Odometry"), ahead, delay_ns=-leap_ns)
    _, frames, _ = said_by(written([*clouds(3), *messages]))
    # the pose holds in the middle of the sweep, between two samples
    speeds = [frame.moved.speed_m_per_s for frame in frames[2:-2] if frame.moved is not None]
    assert speeds == pytest.approx(np.arange(2, 28), abs=0.01)


def test_chunks_with_motion_alone_are_read_where_they_are_small() -> None:
    motion = moved(ODOMETRY, ros2("nav_msgs/Odometry"), circling(3, silent="pose"))
    plan, frames, _ = said_by(written([*clouds(3), *motion], apart=True))
    check(frames)
    alone, _, _ = said_by(written(clouds(3)))
    assert len(plan.shards[0].chunks) > len(alone.shards[0].chunks)
    assert plan.shards[0].needed_bytes == sum(ref.length for ref in plan.shards[0].chunks)


def test_images_between_which_motion_lies_are_not_read_for_it() -> None:
    noise = np.random.default_rng(0)
    motion = moved(ODOMETRY, ros2("nav_msgs/Odometry"), circling(3))
    images = [(IMAGES, Said("/camera", each.stamp_ns, noise.bytes(20_000))) for each in circling(3)]
    data = written([*clouds(3), *motion, *images], apart=True)
    plan, frames, damage = said_by(data)
    alone, _, _ = said_by(written(clouds(3), apart=True))
    assert plan.shards[0].needed_bytes == pytest.approx(alone.shards[0].needed_bytes, rel=0.01)
    assert {frame.moved for frame in frames} == {None}
    assert damage == []
    assert plan.shards[0].motion is not None
    assert plan.shards[0].lidar.topic == LIDAR
