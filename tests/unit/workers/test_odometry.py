import math
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.frame import LidarFrame, OdometryState, PosedFrame
from workers.odometry.odometry import KissOdometry

PERIOD_NS = 100_000_000
START_NS = 1_700_000_000_000_000_000


def street(x: float) -> NDArray[np.float32]:
    """Points of a street with walls, posts and a road, seen from x metres along it."""
    some = np.random.default_rng(0)  # an even grid would look the same one step further on
    along = some.uniform(-70.0, 90.0, 12_000)
    side = np.where(some.random(12_000) < 0.5, -1.0, 1.0)
    # walls with bays, so that the way along the street can be told
    depth = 15.0 + 2.0 * (np.floor(along / 7.0) % 2)
    walls = np.stack([along, side * depth, some.uniform(-1.8, 4.0, 12_000)], axis=-1)
    road = some.uniform([-50.0, -14.0, -1.8], [70.0, 14.0, -1.78], (6_000, 3))
    posts = some.uniform([0.0, 9.0, -1.8], [0.2, 9.2, 3.0], (600, 3))
    posts[:, 0] += 11.0 * (np.arange(600) % 12 - 5)
    world = np.concatenate([walls, road, posts])
    seen: NDArray[np.float32] = (world - np.array([x, 0.0, 0.0])).astype(np.float32)
    return seen


def rings() -> NDArray[np.float32]:
    """What beams hit of an even road: the same circles about the sensor wherever it is."""
    radius, angle = np.meshgrid(np.geomspace(4.0, 40.0, 25), np.radians(np.arange(0, 360, 0.5)))
    return (
        np.stack(
            [radius * np.cos(angle), radius * np.sin(angle), np.full_like(radius, -1.8)], axis=-1
        )
        .reshape(-1, 3)
        .astype(np.float32)
    )


def frame_of(
    points: NDArray[np.float32], stamp_ns: int, *, has_point_time: bool = False
) -> LidarFrame:
    n = len(points)
    valid: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
    return LidarFrame(
        log_id="street",
        stamp_ns=stamp_ns,
        points_m=np.where(valid[:, None], points, 0.0).astype(np.float32),
        intensity=np.zeros(n, np.float32),
        offset_ns=np.zeros(n, np.int32),
        ring=np.full(n, -1, np.int16),
        valid_mask=valid,
        has_point_time=has_point_time,
    )


def drive(frames: int, *, speed_m_per_s: float = 5.0) -> Iterator[LidarFrame]:
    for number in range(frames):
        yield frame_of(street(number * 0.1 * speed_m_per_s), START_NS + number * PERIOD_NS)


def poses(frames: list[LidarFrame]) -> list[PosedFrame]:
    return list(KissOdometry()(frames))


def test_the_first_pose_is_the_origin_and_driving_is_followed() -> None:
    answers = poses(list(drive(8)))
    np.testing.assert_array_equal(answers[0].odom_from_sensor, np.eye(4))
    assert all(answer.odometry is OdometryState.HEALTHY for answer in answers)
    for number, answer in enumerate(answers):
        np.testing.assert_allclose(
            answer.odom_from_sensor[:3, 3], [0.5 * number, 0.0, 0.0], atol=0.05
        )


def test_the_residual_of_static_structure_is_centimetres() -> None:
    answers = poses(list(drive(4)))
    assert np.isnan(answers[0].static_residual_m)
    assert all(0.0 <= answer.static_residual_m < 0.1 for answer in answers[1:])


def test_equal_stamps_of_all_points_do_not_end_the_process() -> None:
    frames = [
        frame_of(street(0.0), START_NS + i * PERIOD_NS, has_point_time=True) for i in range(3)
    ]
    assert all(answer.odometry is OdometryState.HEALTHY for answer in poses(frames))


@pytest.mark.parametrize(
    "points",
    [
        pytest.param(np.zeros((0, 3), np.float32), id="no point"),
        pytest.param(np.full((1, 3), 7.0, np.float32), id="one point"),
        pytest.param(np.full((5000, 3), 7.0, np.float32), id="all points equal"),
        pytest.param(np.full((5000, 3), np.nan, np.float32), id="no number"),
    ],
)
def test_a_frame_that_cannot_be_registered_gets_the_predicted_pose_and_a_reason(
    points: NDArray[np.float32],
) -> None:
    frames = list(drive(8))
    frames[5] = frame_of(points, frames[5].stamp_ns)
    answers = poses(frames)
    assert answers[5].odometry is OdometryState.DEGRADED
    assert answers[5].reason
    np.testing.assert_allclose(answers[5].odom_from_sensor[0, 3], 2.5, atol=0.1)
    assert answers[7].odometry is OdometryState.HEALTHY
    np.testing.assert_allclose(answers[7].odom_from_sensor[0, 3], 3.5, atol=0.1)


def test_the_pose_is_lost_after_half_a_second_of_nothing() -> None:
    frames = list(drive(14))
    nothing = np.zeros((0, 3), np.float32)
    frames[3:12] = [frame_of(nothing, frame.stamp_ns) for frame in frames[3:12]]
    states = [answer.odometry for answer in poses(frames)]
    assert states[3] is OdometryState.DEGRADED
    assert states[11] is OdometryState.LOST


def test_a_log_that_begins_with_nothing_is_lost_until_something_is_seen() -> None:
    frames = list(drive(4))
    frames[0] = frame_of(np.zeros((0, 3), np.float32), frames[0].stamp_ns)
    states = [answer.odometry for answer in poses(frames)]
    assert states == [OdometryState.LOST, *[OdometryState.HEALTHY] * 3]


@pytest.mark.parametrize(
    ("jump_s", "said"),
    [pytest.param(2.0, "no frame for", id="gap"), pytest.param(-0.3, "time went back", id="back")],
)
def test_after_a_break_in_time_the_pose_goes_on_from_the_last_one_and_says_so(
    jump_s: float, said: str
) -> None:
    frames = list(drive(8))
    jump_ns = int(jump_s * 1e9)
    for i in range(5, 8):
        frames[i] = frame_of(street(30.0 + 0.5 * i), frames[i].stamp_ns + jump_ns)
    answers = poses(frames)
    assert answers[5].odometry is OdometryState.DEGRADED
    assert said in answers[5].reason
    np.testing.assert_allclose(answers[5].odom_from_sensor, answers[4].odom_from_sensor, atol=1e-9)
    assert answers[6].odometry is OdometryState.HEALTHY
    moved = answers[7].odom_from_sensor[0, 3] - answers[6].odom_from_sensor[0, 3]
    np.testing.assert_allclose(moved, 0.5, atol=0.06)


def test_a_missing_frame_does_not_break_the_constant_velocity() -> None:
    frames = [frame for i, frame in enumerate(drive(10, speed_m_per_s=10.0)) if i not in (5, 6)]
    answers = poses(frames)
    assert all(answer.odometry is OdometryState.HEALTHY for answer in answers)
    np.testing.assert_allclose(answers[-1].odom_from_sensor[0, 3], 9.0, atol=0.1)


def test_a_car_that_sets_off_is_followed_although_the_rings_on_the_road_stay() -> None:
    time_s = np.arange(30) * 0.1
    x = np.where(time_s > 1.5, (time_s - 1.5) ** 2, 0.0)
    frames = [
        frame_of(
            np.concatenate([structure[structure[:, 2] > -1.7], rings()]), START_NS + i * PERIOD_NS
        )
        for i, structure in enumerate(street(float(each)) for each in x)
    ]
    found = np.array([answer.odom_from_sensor[0, 3] for answer in poses(frames)])
    np.testing.assert_allclose(found, x, atol=0.12)


def test_a_car_that_teleports_is_not_healthy() -> None:
    frames = list(drive(8))
    for i in range(5, 8):
        frames[i] = frame_of(street(0.5 * i + 1.5), frames[i].stamp_ns)
    answers = poses(frames)
    assert answers[5].odometry is not OdometryState.HEALTHY
    assert "jumped" in answers[5].reason


def test_two_frames_that_fit_nothing_are_not_believed_and_bend_no_map() -> None:
    """As of a sensor that is behind a lorry at arm's length for a moment."""
    clean, frames = poses(list(drive(16))), list(drive(16))
    for number in (8, 9):
        other = np.random.default_rng(number).uniform(-9.0, 9.0, (8_000, 3)).astype(np.float32)
        frames[number] = frame_of(other, frames[number].stamp_ns)
    answers = poses(frames)
    assert all(answers[number].reason.startswith("not believed: ") for number in (8, 9))
    assert all(answers[number].odometry is OdometryState.DEGRADED for number in (8, 9))
    assert all(answer.odometry is OdometryState.HEALTHY for answer in answers[10:])
    found, right = (np.stack([a.odom_from_sensor for a in each]) for each in (answers, clean))
    np.testing.assert_allclose(found, right, atol=0.05)


def test_where_nothing_stands_near_a_pose_is_doubted() -> None:
    far = street(0.0)[np.abs(street(0.0)[:, 1]) > 14.5] * np.float32(3.2)
    frames = [
        frame_of(far + np.array([-0.5 * i, 0.0, 0.0], np.float32), START_NS + i * PERIOD_NS)
        for i in range(4)
    ]
    first, *later = poses(frames)
    assert first.odometry is OdometryState.HEALTHY  # it is the origin
    assert {each.odometry for each in later} == {OdometryState.DEGRADED}
    assert all("nothing stands near" in each.reason for each in later)


def test_an_odometry_that_goes_astray_begins_anew() -> None:
    frames, yaw = list[LidarFrame](), 0.0
    for number in range(40):
        yaw += math.radians(65.0) if 8 <= number < 17 else 0.0
        cos, sin = math.cos(yaw), math.sin(yaw)
        spun = street(number * 0.5) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
        frames.append(frame_of(spun.astype(np.float32), START_NS + number * PERIOD_NS))
    answers = poses(frames)
    states = [answer.odometry for answer in answers]
    assert states[:8] == [OdometryState.HEALTHY] * 8
    assert states[8:14] == [OdometryState.LOST] * 6  # a sensor that spins: nothing can be known
    assert states[18:] == [OdometryState.HEALTHY] * 22  # where nothing began anew, all were lost
    assert any("starts anew: astray" in answer.reason for answer in answers)
    moved = np.linalg.norm(
        np.diff([a.odom_from_sensor[:3, 3] for a in answers[18:]], axis=0), axis=1
    )
    np.testing.assert_allclose(moved, 0.5, atol=0.1)


def test_the_same_frames_give_the_same_poses() -> None:
    for one, other in zip(poses(list(drive(5))), poses(list(drive(5))), strict=True):
        np.testing.assert_array_equal(one.odom_from_sensor, other.odom_from_sensor)


def test_the_version_names_the_method_and_a_digest() -> None:
    name, _, digest = KissOdometry().version.partition("@")
    assert name == "kiss-icp"
    assert len(digest) == 12
