"""A place is occluded by a point in front of it, unless one is seen near it or beyond."""

import numpy as np
import pytest
from numpy.typing import NDArray

from workers.contradiction.occlusion import RangeBounds, occluded_share, range_bounds_of


def _wall(x_m: float, *, side_m: float = 4.0) -> NDArray[np.float32]:
    """A wall across the way ahead, a point every decimetre."""
    across, up = np.meshgrid(np.arange(-side_m, side_m, 0.1), np.arange(-1.5, 2.0, 0.1))
    return np.column_stack((np.full(across.size, x_m), across.ravel(), up.ravel())).astype("f4")


def _bounds(*parts: NDArray[np.float32], ground: bool = False) -> RangeBounds:
    points = np.concatenate(parts)
    return range_bounds_of(points, np.arange(len(points)), np.full(len(points), ground))


def _hidden(place_m: tuple[float, float, float], bounds: RangeBounds) -> float:
    return occluded_share(np.array([place_m]), np.eye(4), bounds, 0.5)


@pytest.mark.parametrize(
    ("place_m", "hidden"),
    [
        ((20.0, 0.0, 0.0), 1.0),  # behind
        ((10.3, 0.0, 0.0), 0.0),  # in it, as near as can be told
        ((5.0, 0.0, 0.0), 0.0),  # before it
        ((20.0, 15.0, 0.0), 0.0),  # beside: nothing came back, and nothing hides
        ((20.0, 0.0, 8.0), 0.0),  # above
        ((-20.0, 0.0, 0.0), 0.0),  # on the other side of the car
    ],
)
def test_a_wall_hides_what_is_behind_it(place_m: tuple[float, float, float], hidden: float) -> None:
    assert _hidden(place_m, _bounds(_wall(10.0))) == hidden


def test_nothing_is_hidden_where_something_is_seen_beyond() -> None:
    fence = _wall(10.0)[::7]
    behind = (20.0, 0.0, 0.0)
    assert _hidden(behind, _bounds(fence)) == 1.0
    assert _hidden(behind, _bounds(fence, _wall(30.0, side_m=12.0))) == 0.0


def test_ground_hides_nothing() -> None:
    assert _hidden((20.0, 0.0, 0.0), _bounds(_wall(10.0), ground=True)) == 0.0


def test_rows_that_are_not_chosen_and_the_car_itself_hide_nothing() -> None:
    points = np.concatenate((_wall(10.0), _wall(0.5, side_m=0.2)))
    bounds = range_bounds_of(points, np.arange(2800, len(points)), np.zeros(len(points), bool))
    assert _hidden((20.0, 0.0, 0.0), bounds) == 0.0


def test_it_goes_round_behind_the_car_and_by_the_pose() -> None:
    bounds = _bounds(_wall(10.0) * np.array([-1, 1, 1], np.float32))
    places = np.array([(20.0, y, 0.0) for y in (-0.02, 0.0, 0.02)])
    turned = np.diag([-1.0, -1.0, 1.0, 1.0])
    assert occluded_share(places, turned, bounds, 0.5) == 1.0
    far_off = turned.copy()
    far_off[:3, 3] = 14.0, 0.0, 0.0
    assert occluded_share(places, far_off, bounds, 0.5) == 0.0


def test_the_occluded_share_of_places_is_returned() -> None:
    places = np.array([(20.0, 0.0, 0.0), (5.0, 0.0, 0.0), (20.0, 15.0, 0.0), (20.0, 1.0, 0.0)])
    assert occluded_share(places, np.eye(4), _bounds(_wall(10.0)), 0.5) == 0.5
