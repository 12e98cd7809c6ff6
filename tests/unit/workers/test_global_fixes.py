"""Global fixes of a log reach its frames, whatever else its receiver says."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, RecordedFix
from schemas.mining import MiningSettings
from schemas.surroundings import EARTH
from schemas.transport.bucket import open_bucket
from schemas.work import Channel, Damage, LogPlan
from tests.fix_logs import (
    JSON_FIX,
    ODOMETRY,
    PROTO_FIX,
    ROS_FIX,
    Fix,
    Kind,
    driving,
    location_fix,
    location_fix_json,
    log_with,
    nav_sat_fix,
    odometry,
)
from tests.tiny_logs import only_recording, settings
from workers.ingest.global_fixes import find_fixes
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.ingest.topics import Topic


def read(
    data: bytes, using: MiningSettings | None = None
) -> tuple[LogPlan, list[LidarFrame], list[Damage]]:
    using = using or settings()
    bucket = open_bucket("memory://")
    bucket.put("drive.mcap", data)
    recording = only_recording(bucket)
    plan = plan_recording(bucket, recording, using)
    shard = plan.shards[0].model_validate_json(plan.shards[0].model_dump_json())
    reader = read_shard(bucket, recording, shard, using)
    return plan, list(reader.frames()), reader.damage


def fixes_of(frames: Sequence[LidarFrame]) -> list[RecordedFix]:
    return [fix for frame in frames for fix in frame.fixes]


def as_recorded(fixes: Sequence[Fix]) -> list[RecordedFix]:
    return [RecordedFix(f.stamp_ns, EARTH, (f.latitude_deg, f.longitude_deg)) for f in fixes]


@pytest.mark.parametrize(
    ("kind", "encode"),
    [
        (ROS_FIX, nav_sat_fix()),
        (PROTO_FIX, location_fix),
        (JSON_FIX, location_fix_json),
    ],
    ids=["NavSatFix", "protobuf", "JSON"],
)
def test_frames_carry_the_fixes_of_their_log(kind: Kind, encode: Callable[[Fix], bytes]) -> None:
    drove = driving(3.8)
    plan, frames, damage = read(log_with(drove, kind, encode))
    assert (plan.refused, len(frames), damage) == ("", 40, [])
    assert fixes_of(frames) == as_recorded(drove)
    assert all(abs(fix.time_ns - f.stamp_ns) <= NS_PER_S for f in frames for fix in f.fixes)


def test_a_log_without_fixes_has_the_plan_that_it_had() -> None:
    plan, frames, _ = read(log_with([]))
    assert fixes_of(frames) == []
    assert "fixes" not in plan.shards[0].model_dump()


@pytest.mark.parametrize("topic", ["none", "/other"])
def test_no_place_is_read_where_none_is_wanted(topic: str) -> None:
    using = settings().model_copy(update={"place_topic": topic})
    plan, frames, _ = read(log_with(driving(3)), using)
    assert plan.shards[0].fixes is None
    assert fixes_of(frames) == []


def test_odometry_counts_only_where_it_is_named_and_motion_is_read_from_it_too() -> None:
    east = [
        replace(each, latitude_deg=690_000.0 + 2 * at, longitude_deg=5.0)
        for at, each in enumerate(driving(3.8))
    ]
    data = log_with(east, ODOMETRY, odometry("utm"))
    assert fixes_of(read(data)[1]) == []
    named = settings().model_copy(update={"place_topic": "/gps/fix"})
    plan, frames, damage = read(data, named)
    assert damage == []
    assert [fix.frame for fix in fixes_of(frames)] == ["utm"] * len(east)
    assert fixes_of(frames)[3].at == (690_006.0, 5.0)
    assert plan.shards[0].motion is not None
    assert any(frame.moved is not None for frame in frames)


def test_stamps_of_another_clock_are_related_by_log_times() -> None:
    drove = [replace(each, stamp_ns=each.stamp_ns - 500 * NS_PER_S) for each in driving(3.8)]
    data = log_with(drove, delay_ns=500 * NS_PER_S)
    assert [fix.time_ns for fix in fixes_of(read(data)[1])] == [f.stamp_ns for f in driving(3.8)]


BAD = {
    "not finite": lambda fix: replace(fix, latitude_deg=float("nan")),
    "without a fix": lambda fix: replace(fix, status=-1),
    "beyond the Earth": lambda fix: replace(fix, latitude_deg=200.0),
    "that jump": lambda fix: replace(fix, latitude_deg=fix.latitude_deg + 0.5),
}


@pytest.mark.parametrize("cause", BAD)
def test_bad_fixes_are_left_out_and_counted_and_the_log_is_mined(cause: str) -> None:
    drove = driving(3.8)
    bad = {3, 8, 9} if cause != "that jump" else {3, 8, 12}
    said = [BAD[cause](each) if at in bad else each for at, each in enumerate(drove)]
    plan, frames, damage = read(log_with(said))
    assert (plan.refused, len(frames)) == ("", 40)
    good = [each for at, each in enumerate(drove) if at not in bad]
    assert fixes_of(frames) == as_recorded(good)
    said_so = [each.what for each in damage]
    if cause == "without a fix":
        assert said_so == [], "a tunnel is no damage"
    else:
        assert said_so == [f"3 of 20 global fixes are not used: 3 {cause} (/gps/fix)"]


def test_a_first_fix_that_jumps_is_left_out_and_a_real_jump_is_followed() -> None:
    drove = driving(3.8)
    first = [BAD["that jump"](drove[0]), *drove[1:]]
    assert fixes_of(read(log_with(first))[1]) == as_recorded(drove[1:])
    tunnel = [*drove[:9], *(BAD["that jump"](each) for each in drove[9:])]
    assert fixes_of(read(log_with(tunnel))[1]) == as_recorded(tunnel)


def test_a_receiver_that_was_never_set_has_no_fix() -> None:
    nowhere = [replace(each, latitude_deg=0.0, longitude_deg=0.0) for each in driving(3.8)]
    _, frames, damage = read(log_with(nowhere))
    assert (fixes_of(frames), damage) == ([], [])


def test_bytes_that_are_no_fix_are_counted() -> None:
    _, frames, damage = read(log_with(driving(3.8), ROS_FIX, lambda fix: b"\x00\x01\x00\x00odd"))
    assert (len(frames), fixes_of(frames)) == (40, [])
    assert [each.what for each in damage] == [
        "20 of 20 global fixes are not used: 20 unreadable (/gps/fix)"
    ]


def test_of_several_topics_navsatfix_comes_first_and_then_the_first_name() -> None:
    known = [
        Topic(
            Channel(
                topic=topic,
                message_encoding=encoding,
                schema_name=name,
                schema_encoding="",
                schema_base64="",
                ids=(),
            ),
            messages,
        )
        for topic, encoding, name, messages in (
            ("/a", "json", "foxglove.LocationFix", 9),
            ("/b", "ros1", "sensor_msgs/NavSatFix", 0),
            ("/d", "cdr", "sensor_msgs/msg/NavSatFix", 9),
            ("/c", "ros1", "sensor_msgs/NavSatFix", 9),
            ("/odom", "cdr", "nav_msgs/msg/Odometry", 9),
        )
    ]
    found = {wanted: find_fixes(known, wanted) for wanted in ("", "/a", "/odom", "none", "/x")}
    names = {wanted: channel and channel.topic for wanted, channel in found.items()}
    assert names == {"": "/c", "/a": "/a", "/odom": "/odom", "none": None, "/x": None}
