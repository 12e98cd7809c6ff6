import numpy as np

from schemas.arrays import Transform
from workers.paper.object_flow import object_flow
from workers.paper.scene_flow import nearest_neighbour_flow
from workers.points.se3 import transform

POINTS = np.random.default_rng(0).uniform(-30, 30, (200, 3)).astype(np.float32)


def ego_motion(*, forward_m: float, turn_rad: float) -> Transform:
    """The sensor moves forward and turns left: this frame's space to the next one's."""
    motion = np.eye(4)
    motion[:2, :2] = [
        [np.cos(turn_rad), np.sin(turn_rad)],
        [-np.sin(turn_rad), np.cos(turn_rad)],
    ]
    motion[0, 3] = -forward_m
    return motion


def test_a_parked_car_has_no_object_flow_while_we_drive_past_it() -> None:
    next_from_current = ego_motion(forward_m=1.2, turn_rad=0.05)
    scene_flow = transform(next_from_current, POINTS) - POINTS
    np.testing.assert_allclose(object_flow(scene_flow, POINTS, next_from_current), 0.0, atol=1e-5)


def test_a_car_that_keeps_pace_with_us_has_object_flow_but_no_scene_flow() -> None:
    next_from_current = ego_motion(forward_m=1.2, turn_rad=0.0)
    flow = object_flow(np.zeros_like(POINTS), POINTS, next_from_current)
    np.testing.assert_allclose(flow, np.tile([1.2, 0.0, 0.0], (len(POINTS), 1)), atol=1e-5)


def test_nearest_neighbours_follow_what_moves_less_than_its_spacing() -> None:
    next_from_current = ego_motion(forward_m=0.5, turn_rad=0.02)
    moved = transform(next_from_current, POINTS)
    flow = nearest_neighbour_flow(POINTS, moved + np.float32(0.001), next_from_current)
    np.testing.assert_allclose(flow, moved - POINTS, atol=0.01)


def test_there_is_no_flow_to_nowhere() -> None:
    nothing = np.zeros((0, 3), np.float32)
    assert (nearest_neighbour_flow(POINTS, nothing, np.eye(4)) == 0).all()
    assert nearest_neighbour_flow(nothing, POINTS, np.eye(4)).shape == (0, 3)
