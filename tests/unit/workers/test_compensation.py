"""Clouds that were compensated before recording: recognised by their azimuths, or by a setting."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.frame import Compensated, LidarFrame
from workers.lab.simulation.sensor.compensation import compensate
from workers.lab.simulation.sensor.lidar import Lidar, SimulatedFrame, sensor_poses, sweep
from workers.lab.simulation.sensor.sensors import SensorName, mounted
from workers.lab.simulation.world.street import Street
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.street_plan import StreetPlan
from workers.lidar.compensation import is_compensated, to_middle
from workers.lidar.deskew import Twist, deskew, twist

ORIGIN_M = np.zeros(3)


@cache
def street(style: str) -> Street:
    plan = StreetPlan(place="town", style="drives" if style == "drives" else "stands")
    return build_street(3, seconds=1.0, plan=plan)


def swept(sensor: SensorName, style: str) -> tuple[Lidar, SimulatedFrame, Twist]:
    lidar = mounted(sensor, "roof", columns=600)
    frame = sweep(street(style), lidar, 3)
    ends = sensor_poses(street(style), lidar, frame.time_s + np.array([0.0, lidar.period_s]))
    return lidar, frame, twist(np.linalg.inv(ends[0]) @ ends[1]) / lidar.period_s


def from_middle_s(frame: SimulatedFrame) -> NDArray[np.float32]:
    time_s = (frame.offset_ns / 1e9).astype(np.float32)
    about_middle: NDArray[np.float32] = time_s - (time_s.min() + time_s.max()) / 2
    return about_middle


@pytest.mark.parametrize("sensor", ["pandar64", "vlp32c", "os1-128"])
def test_a_moving_cloud_shows_whether_it_was_compensated(sensor: SensorName) -> None:
    lidar, frame, velocity = swept(sensor, "drives")
    time_s, ring = from_middle_s(frame), frame.ring.astype(np.int16)
    middle = compensate(street("drives"), lidar, frame).points_m
    begin = deskew(frame.points_m, time_s - time_s.min(), velocity)
    end = deskew(frame.points_m, time_s - time_s.max(), velocity)
    for points_m, expected in ((frame.points_m, False), (middle, True), (begin, True), (end, True)):
        assert is_compensated(points_m, time_s, ring, velocity, ORIGIN_M) is expected


def test_a_standing_cloud_shows_nothing_and_needs_nothing() -> None:
    lidar, frame, velocity = swept("pandar64", "stands")
    still = compensate(street("stands"), lidar, frame)
    ring, time_s = frame.ring.astype(np.int16), from_middle_s(frame)
    assert not is_compensated(still.points_m, time_s, ring, velocity, ORIGIN_M)
    np.testing.assert_allclose(still.points_m, frame.points_m, atol=0.03)


def test_beams_that_are_not_recorded_and_not_in_line_give_no_opinion() -> None:
    lidar, frame, velocity = swept("pandar64", "drives")
    middle = compensate(street("drives"), lidar, frame)
    nothing = np.full(len(frame), -1, np.int16)
    assert not is_compensated(middle.points_m, from_middle_s(frame), nothing, velocity, ORIGIN_M)


def as_frame(frame: SimulatedFrame, points_m: NDArray[np.float32], how: Compensated) -> LidarFrame:
    return LidarFrame(
        log_id="drive",
        stamp_ns=1_000_000_000,
        points_m=points_m,
        intensity=frame.intensity,
        offset_ns=frame.offset_ns.astype(np.int32),
        ring=frame.ring.astype(np.int16),
        valid_mask=np.ones(len(frame), np.bool_),
        has_point_time=True,
        compensated=how,
    )


@pytest.mark.parametrize(
    ("recorded", "setting", "deskewed"),
    [
        ("raw", "auto", True),
        ("compensated", "auto", False),
        ("raw", "yes", False),
        ("compensated", "no", True),
    ],
)
def test_no_cloud_is_compensated_twice(
    recorded: str, setting: Compensated, *, deskewed: bool
) -> None:
    lidar, swept_frame, velocity = swept("pandar64", "drives")
    points_m = swept_frame.points_m
    if recorded == "compensated":
        points_m = compensate(street("drives"), lidar, swept_frame).points_m
    frame = as_frame(swept_frame, points_m, setting)
    index = np.arange(len(frame))
    moved = to_middle(frame, points_m, index, velocity, ORIGIN_M)
    assert (moved is points_m) is not deskewed
    assert to_middle(frame, points_m, index, None, ORIGIN_M) is points_m
    if recorded == "raw" and deskewed:
        truth = compensate(street("drives"), lidar, swept_frame).points_m
        np.testing.assert_allclose(moved, truth, atol=0.03)
