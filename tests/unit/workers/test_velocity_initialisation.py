"""A log that begins at speed: speeds that its first frames allow, and which one is kept."""

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.frame import LidarFrame, OdometryState
from tests import factories
from workers.lab.simulation.sensor.lidar import Lidar, sensor_poses, sweep
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.street_plan import StreetPlan
from workers.odometry.odometry import KissOdometry
from workers.odometry.velocity_initialisation import candidate_velocities, contradicted_share

RAIL_Y_M = 9.0
SPEED_M_PER_S = 25.0


def between_rails(x_m: float, *, posts: int = 24, heading_rad: float = 0.0) -> LidarFrame:
    """What is seen of rails, wherever one is, and of posts at uneven distances; at x metres."""
    angles = np.radians(np.arange(10.0, 170.0, 0.4))
    along = RAIL_Y_M / np.tan(angles)
    heights = np.arange(-1.2, -0.2, 0.15)
    rail = np.stack(
        [
            np.repeat(along, len(heights)),
            np.full(len(along) * len(heights), RAIL_Y_M),
            np.tile(heights, len(along)),
        ],
        axis=-1,
    )
    some = np.random.default_rng(3)
    at = np.stack(
        [some.uniform(-50.0, 60.0, posts), some.choice([-14.0, 13.0], posts), np.zeros(posts)],
        axis=-1,
    )
    post = at[:, None] + np.stack([np.zeros(30), np.zeros(30), np.linspace(-1.5, 2.5, 30)], axis=-1)
    seen = np.concatenate([rail, rail * [1.0, -1.0, 1.0], (post.reshape(-1, 3) - [x_m, 0.0, 0.0])])
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    turned = seen @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return factories.frame(turned, at_s=x_m / SPEED_M_PER_S)


@pytest.mark.parametrize("heading_rad", [0.0, np.pi / 2])
def test_rails_share_their_votes_and_posts_tell_the_speed(heading_rad: float) -> None:
    first, second = (between_rails(x, heading_rad=heading_rad) for x in (0.0, 2.5))
    best = candidate_velocities(first, second)[0]
    ahead = SPEED_M_PER_S * np.array([np.cos(heading_rad), -np.sin(heading_rad), 0.0])
    np.testing.assert_allclose(best[3:], ahead, atol=2.6)
    np.testing.assert_array_equal(best[:3], 0.0)


def test_two_frames_of_next_to_nothing_allow_no_speed() -> None:
    nothing = factories.frame(np.zeros((0, 3)))
    assert candidate_velocities(nothing, factories.frame(np.zeros((0, 3)), at_s=0.1)) == []


def highway(frames: int) -> Iterator[tuple[LidarFrame, NDArray[np.float64]]]:
    """A bare motorway at 24 m/s from the first frame on, with the true poses."""
    lidar = Lidar()
    street = build_street(4, seconds=6.0, plan=StreetPlan(place="highway", style="drives"))
    for index in range(frames):
        seen = sweep(street, lidar, index)
        time_s = index * lidar.period_s
        pose = sensor_poses(street, lidar, np.array([time_s + lidar.period_s / 2]))[0]
        yield (
            factories.frame(
                seen.points_m,
                at_s=time_s,
                ring=seen.ring.astype(np.int16),
                offset_ns=seen.offset_ns.astype(np.int32),
                has_point_time=True,
            ),
            pose,
        )


def test_a_log_that_begins_at_speed_on_a_motorway_is_followed_from_its_first_frame_on() -> None:
    frames, world_from_sensor = zip(*highway(8), strict=True)
    posed = list(KissOdometry()(frames))
    assert [each.frame for each in posed] == list(frames)
    assert all(each.odometry is OdometryState.HEALTHY for each in posed)
    for number in range(1, len(posed)):
        moved = np.linalg.inv(posed[number - 1].odom_from_sensor) @ posed[number].odom_from_sensor
        truly = np.linalg.inv(world_from_sensor[number - 1]) @ world_from_sensor[number]
        np.testing.assert_allclose(moved[:3, 3], truly[:3, 3], atol=0.2)
        assert np.linalg.norm(truly[:3, 3]) > 2.0
    assert contradicted_share(posed) < 0.2
