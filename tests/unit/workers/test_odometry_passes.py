"""Single passes of the odometry over points, against what numpy says in several."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from workers.odometry.kiss_map import subsample
from workers.odometry.registration_pass import structure, usable


def cloud(n: int) -> NDArray[np.float32]:
    """Points about a sensor, some of them too near and too far."""
    rng = np.random.default_rng(n)
    points: NDArray[np.float32] = rng.normal(0, (40, 40, 2), (n, 3)).astype(np.float32)
    points[: n // 10] /= 20
    return points


def test_usable_returns_are_valid_and_in_reach() -> None:
    points, valid = cloud(3000), np.arange(3000) % 7 > 0
    points[5] = np.nan
    squared = (points.astype(np.float64) ** 2).sum(axis=1)
    expected = points[valid & (squared > 2.5**2) & (squared < 100.0**2)]
    assert 0 < len(expected) < 2600
    np.testing.assert_array_equal(usable(points, valid), expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_structure_stands_off_the_road_and_near(dtype: type[np.floating]) -> None:
    points = cloud(2000).astype(dtype)
    squared = (points[:, :2].astype(np.float64) ** 2).sum(axis=1)
    found = structure(points)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, points[(points[:, 2] > -1.0) & (squared < 40.0**2)])


@pytest.mark.parametrize("n", [1, 2, 99, 1000, 4181])
def test_half_of_the_points_are_chosen_and_few_of_the_road(n: int) -> None:
    points, road_m = cloud(n), -1.2
    step = int(n * 0.6180339887498949)
    while math.gcd(step, n) != 1:
        step += 1
    mixed = points.astype(np.float64)[np.arange(n // 2) * step % n]
    keep = mixed[:, 2] > road_m
    keep[np.flatnonzero(~keep)[::20]] = True
    found = subsample(points, road_m)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, mixed[keep])
