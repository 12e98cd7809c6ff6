from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.camera import CameraCalibration
from schemas.frame import OdometryState, PosedFrame
from schemas.labels import MotionLabel
from schemas.motion_rule import PAPER, PER_SECOND, MotionRule
from tests.factories import frame, posed
from workers.paper.camera_filter import to_flow_space
from workers.paper.object_flow import flow_ends
from workers.paper.scene_flow import nearest_neighbour_flow
from workers.paper.two_stage import TwoStage
from workers.paper.two_stage_clustering import two_stage

DT_S = 0.1
NEAREST = TwoStage("nearest-neighbour", nearest_neighbour_flow)


def blob(centre: tuple[float, float, float], count: int = 200) -> NDArray[np.float32]:
    some = np.random.default_rng(0)
    return (np.array(centre) + some.uniform(-0.7, 0.7, (count, 3))).astype(np.float32)


def flow(velocity: tuple[float, float, float], count: int = 200) -> NDArray[np.float64]:
    return np.tile(np.array(velocity) * DT_S, (count, 1))


def test_a_body_of_one_speed_moves_and_one_that_stands_does_not() -> None:
    points = np.concatenate([blob((10, 0, 0)), blob((20, 0, 0))])
    flows = np.concatenate([flow((6, 0, 0)), flow((0, 0, 0))])
    found = two_stage(points, flows, dt_s=DT_S)
    assert found.dynamic[:200].all()
    assert not found.dynamic[200:].any()


def test_a_body_slower_than_a_walk_is_static() -> None:
    assert not two_stage(blob((10, 0, 0)), flow((1.0, 0, 0)), dt_s=DT_S).dynamic.any()
    assert two_stage(blob((10, 0, 0)), flow((1.2, 0, 0)), dt_s=DT_S).dynamic.all()


def test_points_that_disagree_about_their_speed_are_no_body() -> None:
    noisy = flow((6, 0, 0)) * np.linspace(0.5, 1.5, 200)[:, None]
    found = two_stage(blob((10, 0, 0)), noisy, dt_s=DT_S)
    assert not found.candidate.any()
    assert not found.dynamic.any()


def test_a_car_over_eighty_is_static_as_published() -> None:
    assert not two_stage(blob((10, 0, 0)), flow((30, 0, 0)), dt_s=DT_S).dynamic.any()
    faster = MotionRule(max_speed_m_per_s=60.0)
    assert two_stage(blob((10, 0, 0)), flow((30, 0, 0)), dt_s=DT_S, rule=faster).dynamic.all()


def test_the_rule_goes_by_the_second_and_the_published_one_by_the_frame() -> None:
    # 0.3 m/s apart from point to point: joined neither at 10 Hz nor at 5 Hz, but by the published
    # distance per frame at 20 Hz
    velocities = np.stack([np.linspace(5.0, 5.6, 60), np.zeros(60), np.zeros(60)], axis=-1)
    points = blob((10, 0, 0), 60)
    rule = {"min_points": 10, "min_flow_points": 40}
    by_second = MotionRule(**rule)
    by_frame = MotionRule(**rule, flow_reach_m=PAPER.flow_reach_m)
    for dt_s in (0.2, 0.1, 0.05):
        found = two_stage(points, velocities * dt_s, dt_s=dt_s, rule=by_second)
        assert not found.dynamic.any()
    fast = two_stage(points, velocities * 0.05, dt_s=0.05, rule=by_frame)
    assert fast.dynamic.any()
    assert PER_SECOND.flow_reach_m is None


def test_a_voxel_counts_as_the_points_in_it() -> None:
    points, flows = blob((10, 0, 0), 20), flow((6, 0, 0), 20)
    assert not two_stage(points, flows, dt_s=DT_S).dynamic.any()
    weights = np.full(20, 10)
    assert two_stage(points, flows, dt_s=DT_S, weights=weights).dynamic.all()


def test_each_stage_says_what_it_knew_of_its_clusters() -> None:
    points = np.concatenate([blob((10, 0, 0)), blob((20, 0, 0)), blob((30, 0, 0))])
    flows = np.concatenate([flow((6, 0, 0)), flow((0, 0, 0)), flow((30, 0, 0))])
    found = two_stage(points, flows, dt_s=DT_S)
    moving, still, fast = found.first_speeds
    assert (moving.points, moving.judged_points, moving.moves) == (200, 200, True)
    assert moving.median_m_per_s == pytest.approx(6.0)
    assert np.isnan(still.spread)
    assert not still.moves
    assert (fast.points, fast.judged_points, fast.spread, fast.moves) == (200, 0, 0, False)
    (second,) = found.second_speeds
    assert (second.cluster, second.points, second.moves) == (0, 200, True)


def test_where_flow_ends_is_said_in_the_space_in_which_it_began() -> None:
    axes = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], np.float64)
    camera = CameraCalibration.of(np.eye(4)[:3], axes, width=10, height=10)
    points = blob((10, 0, 0))
    ahead = np.eye(4)
    ahead[0, 3] = 0.5  # the other frame was taken 0.5 m farther on
    stands = np.tile(np.array([0, 0, -0.5], np.float32), (200, 1))  # so all comes nearer
    ends = flow_ends(to_flow_space(points, camera), stands, camera, ahead)
    np.testing.assert_allclose(ends, points, atol=1e-5)


def test_no_points_are_no_motion() -> None:
    nothing = np.zeros((0, 3), np.float32)
    assert two_stage(nothing, nothing, dt_s=DT_S).dynamic.shape == (0,)


def at_rest(
    points: NDArray[np.float32], stamp_ns: int, state: OdometryState = OdometryState.HEALTHY
) -> PosedFrame:
    return posed(frame(points, stamp_ns=stamp_ns), odometry=state)


def thin_line(x: float) -> NDArray[np.float32]:
    """A post of points so sparse along x that the nearest neighbour is the point itself."""
    up = np.linspace(-1.0, 2.0, 150)
    wall = np.stack([np.full(150, 20.0), np.zeros(150), up], axis=-1)
    post = np.stack([np.full(150, x), np.full(150, 5.0), up], axis=-1)
    return np.concatenate([wall, post]).astype(np.float32)


def test_the_stream_sees_a_post_that_moves_and_a_wall_that_stands() -> None:
    frames = [at_rest(thin_line(10.0 + 0.4 * i), 10**18 + i * 100_000_000) for i in range(3)]
    answers = list(NEAREST(frames))
    assert (answers[0].labels == MotionLabel.UNKNOWN).all()
    for answer in answers[1:]:
        assert (answer.labels[150:] == MotionLabel.DYNAMIC).all()
        assert (answer.labels[:150] == MotionLabel.STATIC).all()


def test_nothing_is_known_after_a_gap_or_without_a_pose() -> None:
    frames = [
        at_rest(thin_line(10.0), 10**18),
        at_rest(thin_line(10.4), 10**18 + 10**9),
        at_rest(thin_line(10.8), 10**18 + 11 * 10**8, OdometryState.LOST),
        at_rest(np.zeros((0, 3), np.float32), 10**18 + 12 * 10**8),
    ]
    for answer in NEAREST(frames):
        assert (answer.labels == MotionLabel.UNKNOWN).all()


def test_versions_differ_with_the_rule() -> None:
    assert NEAREST.version != replace(NEAREST, rule=PAPER).version
