import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.paper.object_flow import object_flow
from workers.paper.rigid_flow import rigid_flow
from workers.paper.scene_flow import nearest_neighbour_flow
from workers.points.se3 import transform

EGO = np.eye(4)
EGO[:3, 3] = (-1.2, 0.1, 0.0)


def side(centre: tuple[float, float], *, seed: int, length_m: float = 4.0) -> Points:
    """The side and the back of a car as a lidar sees them."""
    some = np.random.default_rng(seed)
    along = np.stack([some.uniform(0, length_m, 160), np.zeros(160)], axis=1)
    across = np.stack([np.zeros(80), some.uniform(0, 1.8, 80)], axis=1)
    flat = np.concatenate([along, across]) + np.array(centre)
    return np.column_stack([flat, some.uniform(-1.4, 0.0, 240)]).astype(np.float32)


def seen(
    *moved_m: tuple[float, float],
) -> tuple[Points, Points, list[NDArray[np.intp]]]:
    """Cars of this frame, and where they were in the other one, about its own sensor."""
    centres = [(8.0, 4.0), (15.0, -6.0), (-12.0, 5.0)][: len(moved_m)]
    now = [side(centre, seed=k) for k, centre in enumerate(centres)]
    # sampled anew, as a lidar does: no point of one frame is in the other
    then = [
        side((x + dx, y + dy), seed=k + 10)
        for k, ((x, y), (dx, dy)) in enumerate(zip(centres, moved_m, strict=True))
    ]
    ends = np.cumsum([0, *(len(each) for each in now)])
    index = [np.arange(ends[k], ends[k + 1]) for k in range(len(now))]
    other = transform(EGO, np.concatenate(then))
    return np.concatenate(now), other.astype(np.float32), index


def test_a_car_goes_as_a_whole_and_a_parked_one_only_as_we_drive() -> None:
    points, other, (moving, parked) = seen((-1.1, 0.0), (0.0, 0.0))
    flow = object_flow(rigid_flow(points, other, EGO), points, EGO)
    assert np.ptp(flow[moving], axis=0).max() < 1e-5
    np.testing.assert_allclose(flow[moving].mean(axis=0)[:2], (-1.1, 0.0), atol=0.05)
    np.testing.assert_allclose(flow[parked].mean(axis=0), 0.0, atol=0.05)


def test_its_nearest_neighbour_sees_a_fraction_of_that_motion() -> None:
    points, other, (moving,) = seen((-1.1, 0.0))
    nearest = object_flow(nearest_neighbour_flow(points, other, EGO), points, EGO)
    assert np.linalg.norm(nearest[moving].mean(axis=0)) < 0.5


@pytest.mark.parametrize("moved_m", [4.3, 6.0])
def test_it_looks_as_far_as_eighty_kilometres_per_hour_go_in_a_fifth_of_a_second(
    moved_m: float,
) -> None:
    points, other, (moving,) = seen((0.0, moved_m))
    flow = object_flow(rigid_flow(points, other, EGO), points, EGO)
    found = float(np.linalg.norm(flow[moving].mean(axis=0)))
    assert (found == pytest.approx(moved_m, abs=0.1)) == (moved_m < 4.5)


def test_specks_walls_and_an_empty_other_frame_have_the_flow_of_the_car_alone() -> None:
    speck = np.array([[5.0, 5.0, 0.0], [5.1, 5.0, 0.0]], np.float32)
    wall = np.column_stack([np.linspace(-20, 20, 400), np.full(400, 10.0), np.zeros(400)]).astype(
        np.float32
    )
    points = np.concatenate([speck, wall])
    shifted = (transform(EGO, points) + np.float32(0.7)).astype(np.float32)
    for other in (shifted, np.zeros((0, 3), np.float32)):
        flow = object_flow(rigid_flow(points, other, EGO), points, EGO)
        np.testing.assert_allclose(flow, 0.0, atol=1e-5)
    nothing = np.zeros((0, 3), np.float32)
    assert rigid_flow(nothing, shifted, EGO).shape == (0, 3)
