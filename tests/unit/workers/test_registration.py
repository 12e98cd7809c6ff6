import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workers.points.clusters import connected
from workers.points.neighbours import build_grid, nearest_distances
from workers.points.voxels import voxelize
from workers.selfsupervised.registration import (
    STILL_M,
    RegistrationResiduals,
    build_reference,
    register,
)


def car(x: float, y: float, *, seed: int) -> NDArray[np.float32]:
    """Side and front of a car, hit at other places in every frame."""
    some = np.random.default_rng(seed)
    side = np.stack([some.uniform(0, 4.2, 300), np.zeros(300), some.uniform(-1.5, -0.3, 300)], -1)
    front = np.stack([np.zeros(150), some.uniform(0, 1.8, 150), some.uniform(-1.5, -0.3, 150)], -1)
    seen: NDArray[np.float32] = np.concatenate([side, front]).astype(np.float32)
    return seen + np.array([x, y, 0.0], np.float32)


def fit(
    now: NDArray[np.float32], near: NDArray[np.float32], far: NDArray[np.float32]
) -> RegistrationResiduals:
    clusters = connected(now, reach_m=0.5, min_points=3)
    return register(
        now,
        clusters,
        build_reference(near, np.zeros(3), 0.1),
        build_reference(far, np.zeros(3), 0.5),
    )


@pytest.mark.parametrize("speed_m_per_s", [1.5, 4.0, 8.0, 15.0, 27.0])
def test_a_moving_car_is_taken_back_to_where_it_was(speed_m_per_s: float) -> None:
    found = fit(
        car(20.0, 5.0, seed=0),
        car(20.0 + 0.1 * speed_m_per_s, 5.0, seed=1),
        car(20.0 + 0.5 * speed_m_per_s, 5.0, seed=2),
    )
    assert found.tried.tolist() == [True]
    np.testing.assert_allclose(found.shift_far_m[0], [0.5 * speed_m_per_s, 0.0, 0.0], atol=0.15)
    assert found.energy_far[0] < 0.2


def test_a_standing_car_is_still() -> None:
    found = fit(*(car(20.0, 5.0, seed=seed) for seed in range(3)))
    assert found.still_energy_far[0] < 1.5 * STILL_M
    assert np.linalg.norm(found.shift_far_m[0]) < 0.2


def test_a_cluster_longer_than_any_vehicle_is_not_registered() -> None:
    wall = np.stack([np.arange(0, 30, 0.1), np.full(300, 8.0), np.zeros(300)], -1)
    found = fit(*[wall.astype(np.float32)] * 3)
    assert found.tried.tolist() == [False]
    assert found.extent_m[0] == pytest.approx(29.9, abs=0.1)


def test_nearest_distances_are_those_of_a_search_tree() -> None:
    some = np.random.default_rng(3)
    points = some.uniform([-90, -90, -9], [90, 90, 6], (4000, 3)).astype(np.float32)
    asked = some.uniform([-95, -95, -12], [95, 95, 8], (3000, 3)).astype(np.float32)
    found = nearest_distances(build_grid(points, np.zeros(3)), asked, 2.0)
    expected, _ = cKDTree(points).query(asked)
    np.testing.assert_allclose(found, np.minimum(expected, 2.0), atol=1e-4)


def test_points_nearer_than_the_reach_are_joined_and_small_sets_are_dropped() -> None:
    row = np.stack([np.arange(0, 2, 0.4), np.zeros(5), np.zeros(5)], -1)
    points = np.concatenate([row, row + 10.0, [[50.0, 0.0, 0.0]]]).astype(np.float32)
    clusters = connected(points, reach_m=0.5, min_points=3)
    assert clusters.of_point.tolist() == [0] * 5 + [1] * 5 + [-1]
    assert clusters.of(1).tolist() == [5, 6, 7, 8, 9]
    assert len(connected(points, reach_m=0.3, min_points=3)) == 0


def test_points_of_different_groups_are_never_joined() -> None:
    points = np.stack([np.arange(0, 2, 0.2), np.zeros(10), np.zeros(10)], -1).astype(np.float32)
    groups = np.array([0, 1] * 5, np.int32)
    clusters = connected(points, reach_m=0.5, min_points=1, groups=groups)
    assert clusters.of_point.tolist() == groups.tolist()


def test_clusters_of_no_points_are_none() -> None:
    assert len(connected(np.zeros((0, 3), np.float32), reach_m=0.5, min_points=1)) == 0


def test_a_voxel_is_the_mean_of_its_points_and_every_point_knows_its_voxel() -> None:
    points = np.array([[0.01, 0.01, 0.01], [5, 5, 5], [0.03, 0.05, 0.01]], np.float32)
    voxels = voxelize(points)
    assert voxels.of_point.tolist() == [0, 1, 0]
    expected = np.array([[0.02, 0.03, 0.01], [5.0, 5.0, 5.0]], np.float32)
    np.testing.assert_allclose(voxels.centroids_m, expected, atol=1e-6)


def test_voxels_on_both_sides_of_zero_are_different() -> None:
    voxels = voxelize(np.array([[-0.01, 0, 0], [0.01, 0, 0]], np.float32))
    assert voxels.of_point.tolist() == [0, 1]
