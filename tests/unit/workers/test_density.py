"""DBSCAN over places, and counts around points, against libraries and plain loops."""

import numpy as np
import pytest
from numpy.typing import NDArray
from sklearn.cluster import DBSCAN

from workers.contradiction.neighbour_counts import counts_around
from workers.points.density import density_clusters, weighted_places

VOXEL_M = np.float32(0.1)


def blobs(seed: int, *, even: bool = False) -> NDArray[np.float32]:
    """Some things among specks; on an even grid many are exactly as far apart as the reach."""
    rng = np.random.default_rng(seed)
    centres = rng.normal(0, 20, (12, 3)) * (1, 1, 0.05)
    points = centres[rng.integers(0, 12, 2500)] + rng.normal(0, 0.6, (2500, 3))
    points = np.concatenate([points, rng.uniform(-40, 40, (200, 3))])
    return (np.round(points * 4) / 4 if even else points).astype(np.float32)


@pytest.mark.parametrize("even", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_clusters_have_the_numbers_of_the_library(seed: int, even: bool) -> None:
    places, of_point, weight = weighted_places(blobs(seed, even=even), VOXEL_M)
    library = DBSCAN(eps=1.0, min_samples=10).fit_predict(places, sample_weight=weight)
    ours = density_clusters(places, weight, 1.0, 10)
    assert library.max() > 4
    assert (library == -1).any()
    np.testing.assert_array_equal(ours, library)
    assert len(ours[of_point]) == 2700


def test_clusters_of_one_place_and_of_none() -> None:
    one = np.zeros((1, 3))
    assert density_clusters(one, np.array([10]), 1.0, 10).tolist() == [0]
    assert density_clusters(one, np.array([9]), 1.0, 10).tolist() == [-1]
    assert density_clusters(one[:0], np.zeros(0, np.int64), 1.0, 10).tolist() == []


def test_a_place_is_the_mean_of_its_voxel_and_places_are_in_order() -> None:
    points = blobs(3)
    places, of_point, weight = weighted_places(points, VOXEL_M)
    cells = np.floor(points / VOXEL_M).astype(np.int64)
    expected, place = np.unique(cells, axis=0, return_inverse=True)
    np.testing.assert_array_equal(of_point, place)
    np.testing.assert_array_equal(weight, np.bincount(place))
    means = [np.bincount(place, weights=points[:, axis]) / weight for axis in range(3)]
    np.testing.assert_array_equal(places, np.stack(means, axis=1))
    assert len(expected) < len(points)


def test_counts_are_of_the_points_in_the_block_of_cells_around() -> None:
    points = blobs(4)
    rng = np.random.default_rng(0)
    chosen, asked = np.flatnonzero(rng.random(len(points)) < 0.1), rng.random(len(points)) < 0.7
    cells = np.floor(points / np.float32(0.4)).astype(np.int64)
    close = (np.abs(cells[chosen][:, None] - cells[None]) <= 1).all(axis=2)
    own, around = counts_around(points, chosen, asked, np.float32(0.4))
    np.testing.assert_array_equal(own, close[:, chosen].sum(axis=1))
    np.testing.assert_array_equal(around, close[:, asked].sum(axis=1))
