"""The compiled loops of the self-supervised stream against slow and plain references."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from workers.lidar.spherical import (
    BLOCK,
    column_of,
    columns_of_block,
    fill_block,
    new_block,
    project_block,
    row_above,
    rows_of_steps,
)
from workers.points.cells import sorted_cells
from workers.points.clusters import connected, from_labels
from workers.points.compiled import compiled
from workers.points.neighbours import (
    build_grid,
    is_alone,
    nearest_distances,
    nearest_few,
    nearest_indices,
    nearest_rows,
)
from workers.points.step_names import step, watched
from workers.selfsupervised.ground_artefacts import are_ground_artefacts
from workers.selfsupervised.occupancy import CELL_M, build_occupancy, cells_of, scores_around

HERE = np.eye(4, dtype=np.float32)[:3]
TWO_BEAMS = np.array([-0.2, 0.2], np.float32)
ZEROS_AND_ONES = np.array([[0, 0, -1, 1], [0, 1, 0, 0]], np.float32)


def street(n: int, *, seed: int) -> NDArray[np.float32]:
    """Points in clumps, over a few metres and far outliers."""
    some = np.random.default_rng(seed)
    middle = some.uniform([-30, -30, -3], [30, 30, 3], (n // 20, 3))
    points = middle[some.integers(0, len(middle), n)] + some.normal(0, 0.4, (n, 3))
    points[::500] *= 10.0
    clumped: NDArray[np.float32] = points.astype(np.float32)
    return clumped


@pytest.mark.parametrize("reach_m", [0.3, 0.5])
@pytest.mark.parametrize("grouped", [False, True])
def test_clusters_are_the_components_of_all_pairs_within_reach(
    reach_m: float, *, grouped: bool
) -> None:
    points = street(3000, seed=1)
    some = np.random.default_rng(2)
    groups = some.integers(0, 3 if grouped else 1, len(points)).astype(np.int32)
    among = some.random(len(points)) < 0.8
    pairs = cKDTree(points).query_pairs(reach_m, output_type="ndarray")
    joined = pairs[
        among[pairs].all(axis=1)
        & (groups[pairs[:, 0]] == groups[pairs[:, 1]])
        & (np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1) < reach_m)
    ]
    graph = coo_matrix((np.ones(len(joined)), joined.T), shape=(len(points),) * 2)
    _, component = connected_components(graph, directed=False)
    expected = np.full(len(points), -1)
    for number in range(component.max() + 1):
        inside = np.flatnonzero((component == number) & among)
        if len(inside) >= 3:
            expected[inside] = inside[0]

    found = connected(points, reach_m=reach_m, min_points=3, among=among, groups=groups)
    named = np.append(found.members[found.start[:-1]], -1)
    assert np.array_equal(named[found.of_point], expected)
    assert len(found) > 20


@pytest.mark.parametrize("highest_m", [3.0, 1e5])  # few heights are counted, many are inserted
def test_cells_of_a_column_rise_and_keep_the_order_of_their_points(highest_m: float) -> None:
    points = street(2000, seed=11)
    points[:, :2] *= 0.1  # tall columns
    points[7, 2] = highest_m
    index = np.flatnonzero(np.random.default_rng(12).random(len(points)) < 0.7).astype(np.int32)
    groups = np.random.default_rng(13).integers(0, 3, len(index)).astype(np.int32)
    edge_m = np.float32(0.3)
    x, y, z = np.floor(points[index] / edge_m).astype(np.int64).T
    _, column = np.unique(np.stack([x, y]), axis=1, return_inverse=True)
    first = np.full(column.max() + 1, len(index))
    np.minimum.at(first, column, np.arange(len(index)))
    expected = np.lexsort((np.arange(len(index)), groups, z, first[column]))

    cells = sorted_cells(points, index, groups, edge_m)
    assert np.array_equal(cells.order, expected)
    assert np.array_equal(cells.points_m, points[index[expected]])


@pytest.mark.parametrize("reach_m", [0.2, 0.7])
def test_alone_is_what_has_no_neighbour_within_reach(reach_m: float) -> None:
    points, asked = street(3000, seed=14), street(2000, seed=15)
    grid = build_grid(points, np.zeros(3))
    alone = is_alone(grid, asked, np.float32(reach_m))
    far = nearest_distances(grid, asked, 2.0 * reach_m) > np.float32(reach_m)
    assert np.array_equal(alone, far)
    assert np.array_equal(alone, cKDTree(points).query(asked)[0] > reach_m)
    assert 0 < alone.sum() < len(asked)
    here = is_alone(grid, points[:50] + np.array([reach_m, 0, 0], np.float32), np.float32(reach_m))
    assert not here[:20].all()
    assert is_alone(build_grid(points[:0], np.zeros(3)), asked, np.float32(reach_m)).all()


def test_labels_are_collected_in_their_order() -> None:
    labels = np.array([7, -1, 2, 7, 2, 0, 7], np.int32)
    found = from_labels(labels)
    assert found.of_point.tolist() == [2, -1, 1, 2, 1, 0, 2]
    assert [found.of(k).tolist() for k in range(3)] == [[5], [2, 4], [0, 3, 6]]
    assert len(from_labels(np.full(4, -1, np.int32))) == 0


def test_the_nearest_of_few_points_far_off_the_centre_is_found() -> None:
    points = street(40, seed=3) + np.array([200.0, -150.0, 30.0], np.float32)
    asked = points + np.random.default_rng(4).normal(0, 0.5, points.shape).astype(np.float32)
    grid = build_grid(points, np.zeros(3))
    found = nearest_indices(grid, asked, 0.9)
    distance, nearest = cKDTree(points).query(asked)
    assert np.array_equal(found >= 0, distance < 0.9)
    assert np.array_equal(grid.order[found[found >= 0]], nearest[found >= 0])


def test_the_nearest_few_are_those_of_a_tree_nearest_first() -> None:
    points = street(3000, seed=5)
    points[-1] = 75.0  # so far off that cells are looked at until there are no more
    asked = np.ascontiguousarray(points[::-7])
    distance, nearest = cKDTree(points).query(asked, k=8)
    grid = build_grid(points, np.zeros(3))
    found = nearest_few(grid, asked, 8)
    away = np.linalg.norm(grid.points_m[found].astype(np.float64) - asked[:, None], axis=2)
    assert np.allclose(away, distance, atol=1e-6)
    assert np.array_equal(grid.order[found[:, 0]], nearest[:, 0])
    assert np.array_equal(nearest_rows(grid, asked + np.float64(1e-4), 0.5), found[:, 0])


def test_only_points_within_reach_of_few_are_given_one() -> None:
    few = street(40, seed=9)
    asked = street(3000, seed=10)
    grid = build_grid(few, np.zeros(3))
    for reach_m in (0.2, 0.5, 0.9):
        found = nearest_indices(grid, asked, reach_m)
        distance, nearest = cKDTree(few).query(asked)
        assert np.array_equal(found >= 0, distance < reach_m)
        assert np.array_equal(grid.order[found[found >= 0]], nearest[found >= 0])
        assert 0 < (found >= 0).sum() < len(asked)


def test_members_are_masked_counted_and_averaged_per_cluster() -> None:
    some = np.random.default_rng(11)
    clusters = from_labels(some.integers(-1, 6, 500).astype(np.int32))
    mask, values = some.random(500) < 0.3, some.integers(0, 9, 500).astype(np.int16)
    chosen = np.array([True, False, True, False, False, True])
    of = clusters.of_point
    assert np.array_equal(clusters.member_mask(chosen), (of >= 0) & chosen[of])
    for k in range(6):
        assert clusters.count(mask)[k] == (mask & (of == k)).sum()
        assert clusters.mean(values)[k] == pytest.approx(values[of == k].mean())


def test_coarse_scores_count_cells_on_points_and_beside_them() -> None:
    points = street(500, seed=5)[:, :] * np.float32(0.2)
    occupancy = build_occupancy(points, np.zeros(3))
    cells = cells_of(occupancy, points[::20])
    scores = scores_around(occupancy, cells, 2, -1, 3)
    on = {tuple(cell) for cell in cells_of(occupancy, points).tolist()}
    steps = np.array(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1])).reshape(3, -1).T
    beside = {tuple(np.add(cell, by).tolist()) for cell in on for by in steps}
    for i, j in ((0, 0), (3, 3), (6, 1)):
        moved = [(x + 2 + i - 3, y - 1 + j - 3, z) for x, y, z in cells.tolist()]
        hits = sum(2 * (cell in on) + (cell in beside) for cell in moved)
        assert scores[i, j] == pytest.approx(hits / (3 * len(cells)))
    assert CELL_M == 0.3


@compiled
def of_library(y: np.float32, x: np.float32) -> float:
    return float(np.arctan2(y, x))


def test_columns_are_those_of_the_exact_angle() -> None:
    some = np.random.default_rng(6)
    columns = 1800
    edges = (np.arange(columns + 1) / columns * 2 - 1) * np.pi
    angle = np.concatenate([edges, edges + 1e-6, some.uniform(-np.pi, np.pi, 5000)])
    away = some.uniform(0.1, 90.0, len(angle))
    x, y = (away * np.cos(angle)).astype(np.float32), (away * np.sin(angle)).astype(np.float32)
    x, y = np.append(x, ZEROS_AND_ONES[0]), np.append(y, ZEROS_AND_ONES[1])
    scale = columns / (2 * np.pi)
    # the compiler's library: numpy's own may be off by more than a rounding where it uses AVX-512
    angles = [of_library(*each) for each in zip(y, x, strict=True)]
    exact = [min(max(int((each + np.pi) * scale), 0), columns - 1) for each in angles]
    places = np.stack([x, y, np.zeros_like(x)], axis=1)
    block, steps, found, vectorised = new_block(), rows_of_steps(TWO_BEAMS), [], 0
    for first in range(0, len(places), BLOCK):
        n = fill_block(block, places, first, HERE)
        project_block(block, n, TWO_BEAMS, steps)
        columns_of_block(block, n, columns)
        vectorised += int((block.column[:n] >= 0).sum())
        guesses = zip(block.column[:n].tolist(), block.x[:n], block.y[:n], strict=True)
        found += [column_of(*each, columns) for each in guesses]
    assert np.array_equal(found, exact)
    assert 4000 < vectorised < len(places) - 2 * columns  # those at an edge are looked up


@pytest.mark.parametrize("rows", [1, 2, 16, 64, 3000])
def test_rows_are_those_of_a_search(rows: int) -> None:
    some = np.random.default_rng(rows)
    tangents = np.sort(some.uniform(-0.4, 0.3, rows)).astype(np.float32)
    asked = np.concatenate([tangents, some.uniform(-0.6, 0.5, 500).astype(np.float32)])
    # straight ahead, so that the height is the tangent
    places = np.stack([np.ones_like(asked), np.zeros_like(asked), asked], axis=1)
    _, _, tangent, _, row = looked_at(places, tangents)
    assert np.array_equal(tangent, asked)
    found = [row_above(tangents, int(k), at) for k, at in zip(row, tangent, strict=True)]
    assert np.array_equal(found, np.searchsorted(tangents, asked))


def test_places_are_looked_at_from_a_pose() -> None:
    places = street(2 * BLOCK + 7, seed=8)
    pose = np.array([[0, -1, 0, 3], [1, 0, 0, -2], [0, 0, 1, 0.5]], np.float32)
    across, distance, tangent, angle, _ = looked_at(places, TWO_BEAMS, pose)
    moved = places.astype(np.float64) @ pose[:, :3].T + pose[:, 3]
    assert np.allclose(across, np.hypot(*moved[:, :2].T), rtol=1e-6)
    assert np.allclose(distance, np.linalg.norm(moved, axis=1), rtol=1e-6)
    assert np.allclose(tangent, moved[:, 2] / np.hypot(*moved[:, :2].T), rtol=1e-4, atol=1e-6)
    assert np.allclose(angle, np.arctan2(moved[:, 1], moved[:, 0]), atol=3e-5)


def looked_at(
    places: NDArray[np.float32], tangents: NDArray[np.float32], pose: NDArray[np.float32] = HERE
) -> NDArray[np.float64]:
    """Horizontal distance, distance, tangent, azimuth and a row of each place, block by block."""
    block, steps, seen = new_block(), rows_of_steps(tangents), []
    for first in range(0, len(places), BLOCK):
        n = fill_block(block, places, first, pose)
        project_block(block, n, tangents, steps)
        said = block.across, block.distance, block.tangent, block.angle, block.row
        seen.append(np.stack([each[:n].astype(np.float64) for each in said]))
    return np.concatenate(seen, axis=1)


def test_only_what_is_flat_and_low_is_a_strip() -> None:
    some = np.random.default_rng(7)
    flat = some.uniform([0, 0, 0], [3, 1, 0.1], (40, 3))
    kerb, bonnet = flat + np.array([10, 0, -2.0]), flat + np.array([10, 5, -1.0])
    child = flat * np.array([0.1, 0.3, 10]) + np.array([10, -5, -2.0])
    points = np.concatenate([kerb, bonnet, child, kerb]).astype(np.float32)
    clusters = from_labels(np.repeat(np.arange(4, dtype=np.int32), 40))
    found = are_ground_artefacts(
        points,
        clusters,
        np.array([True, True, True, False]),
        beams_from_odom=np.eye(4),
        sensor_height_m=2.0,
    )
    assert found.tolist() == [True, False, False, False]


def test_a_step_is_seen_only_while_it_is_watched() -> None:
    entered: list[str] = []

    @contextmanager
    def watch(name: str) -> Iterator[None]:
        entered.append(name)
        yield

    @step("doubling")
    def double(x: int) -> int:
        return 2 * x

    assert double(1) == 2
    with watched(watch):
        assert double(2) == 4
    assert double(3) == 6
    assert entered == ["doubling"]
