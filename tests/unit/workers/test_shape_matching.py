"""Distances of shifted shapes are those that a search among all points finds."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from workers.contradiction.shape_matching import Cells, cells_in_box, misfits, tiled

LOW_M, HIGH_M = np.array([-7.0, 2.0, 0.0]), np.array([9.0, 11.0, 2.0])


def _places(count: int, spread_m: float) -> NDArray[np.float32]:
    rng = np.random.default_rng(count)
    return rng.uniform(-spread_m, spread_m, (count, 3)).astype(np.float32)


def _in_box(places: NDArray[np.float32]) -> NDArray[np.float64]:
    inside = ((places > LOW_M) & (places < HIGH_M)).all(axis=1)
    return places[inside, :2].astype(np.float64)


@pytest.mark.parametrize(("count", "spread_m"), [(30_000, 12.0), (500, 12.0), (40_000, 2500.0)])
def test_cells_hold_what_lies_within_bounds(count: int, spread_m: float) -> None:
    places = _places(count, spread_m)
    found = cells_in_box(tiled(places), LOW_M, HIGH_M)
    assert sorted(map(tuple, found.places_m)) == sorted(map(tuple, _in_box(places)))


@pytest.mark.parametrize("count", [30_000, 3_000, 150])
def test_misfits_are_those_of_the_nearest_points(count: int) -> None:
    places, rng = _places(count, 12.0), np.random.default_rng(1)
    # some of the shape falls beside the bounds on every side
    shape = rng.uniform(LOW_M[:2] - 1.5, HIGH_M[:2] + 1.5, (45, 2))
    shifts = rng.uniform(-2.0, 2.0, (20, 2))
    tree = KDTree(_in_box(places))
    away, _ = tree.query(shape + shifts[:, None], distance_upper_bound=1.0)
    nearest = np.sort(np.minimum(away, 1.0), axis=1)[:, :36]
    found = misfits(shape, shifts, cells_in_box(tiled(places), LOW_M, HIGH_M), 1.0, 0.8)
    np.testing.assert_allclose(found, nearest.mean(axis=1), rtol=1e-12)
    assert nearest.mean() > 0.02


def _nothing(places: NDArray[np.float32], low_m: NDArray[np.float64]) -> Cells:
    return cells_in_box(tiled(places), low_m, low_m + 1.0)


@pytest.mark.parametrize("low_m", [[50.0, 0.0, 0.0], [-50.0, 0.0, 0.0], [0.0, 1e7, 0.0]])
def test_where_nothing_is_seen_every_point_is_as_far_as_can_be(low_m: list[float]) -> None:
    for places in (_places(100, 3.0), np.empty((0, 3), np.float32)):
        seen = _nothing(places, np.array(low_m))
        assert len(seen.places_m) == 0
        assert misfits(np.array([low_m[:2]]), np.zeros((1, 2)), seen, 1.0, 0.8).tolist() == [1.0]
