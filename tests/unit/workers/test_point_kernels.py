"""Single passes over points, against what numpy says in several."""

import numpy as np
from numpy.typing import NDArray

from schemas.labels import MotionLabel
from workers.points.point_kernels import (
    first_and_last,
    in_centimetres,
    judged_rows,
    moved,
    moved_rows,
    returns_within,
    rows_about,
    within,
    within_box,
)
from workers.points.se3 import transform
from workers.selfsupervised.point_labels import (
    AGREED,
    ALONE,
    GROUND,
    UNSURE,
    copy_to_points,
    label_ground,
    label_voxels,
    unlabelled_points,
)

S, D, U = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN


def cloud(n: int, seed: int) -> NDArray[np.float32]:
    points: NDArray[np.float32] = (
        np.random.default_rng(seed).normal(0, 30, (n, 3)).astype(np.float32)
    )
    return points


def test_points_are_told_to_the_centimetre_up_to_where_they_fit() -> None:
    points, valid = cloud(900, seed=11) * 6, np.arange(900) % 5 > 0
    points[:40], points[41], points[43] = np.round(points[:40] * 2) / 200, np.nan, (5, 400, 0)
    farthest, nowhere = np.float32(327), np.int16(-32768)
    near = np.abs(points).max(axis=1, initial=0) <= farthest
    seen = np.asarray(valid & near, np.bool_)
    wanted = np.rint(np.where(seen[:, None], points, 0) * np.float32(100)).astype(np.int16)
    wanted[~seen] = nowhere
    assert 100 < seen.sum() < valid.sum()
    np.testing.assert_array_equal(in_centimetres(points, valid, farthest, nowhere), wanted)


def test_points_are_moved_as_matrices_move_them() -> None:
    pose = np.eye(4)
    pose[:2, :2], pose[:3, 3] = [[0.6, -0.8], [0.8, 0.6]], (4000, -7, 1)
    points = cloud(500, seed=12)
    np.testing.assert_allclose(moved(points, pose), transform(pose, points), rtol=1.2e-7)


def test_a_box_holds_what_is_near_along_every_axis() -> None:
    points = cloud(400, seed=9)
    points[::7, 2], points[5] = np.nan, (20, -20, 20)
    expected: NDArray[np.bool_] = np.all(np.abs(points) <= 20, axis=1)
    assert expected[5]
    assert not expected.all()
    np.testing.assert_array_equal(within_box(points, 20.0), expected)


def test_returns_are_valid_finite_and_near() -> None:
    points = cloud(400, seed=0)
    points[::7] = np.nan
    points[3::50, 1] = np.inf
    points[5::40, 2] = -2000.0
    valid = np.arange(400) % 5 > 0
    expected = np.flatnonzero(valid & (np.abs(points) < 1000).all(axis=1))
    assert np.array_equal(returns_within(points, valid, np.float32(1000.0)), expected)


def test_rows_are_chosen_by_range_height_and_ground_and_moved() -> None:
    points = cloud(500, seed=1)
    ground = np.random.default_rng(2).random(500) < 0.3
    across = np.hypot(points[:, 0], points[:, 1])
    near = (across > 10) & (across < 40)
    assert np.array_equal(within(points, 10.0, 40.0), near)
    index = judged_rows(points, ground, 10.0, 40.0, 3.0)
    assert np.array_equal(index, np.flatnonzero(near & ~ground & (points[:, 2] < 3)))
    pose = np.array([[0, -1, 0, 1e5], [1, 0, 0, -2e5], [0, 0, 1, 3.0], [0, 0, 0, 1]])
    assert np.array_equal(moved_rows(points, index, pose), transform(pose, points[index]))
    origin = np.array([1, 2, 3], np.float32)
    assert np.array_equal(rows_about(points, index, origin), points[index] - origin)


def test_first_and_last_are_of_valid_values_only() -> None:
    values = np.array([90, -5, 3, 7, -80], np.int32)
    assert first_and_last(values, np.array([False, True, True, True, False])) == (-5, 7)
    first, last = first_and_last(values, np.zeros(5, np.bool_))
    assert last < first


def test_voxels_take_the_label_of_their_cluster_or_of_what_was_seen_there() -> None:
    moves, both = np.array([True, True, False, False]), np.array([True, False, False, False])
    stands, doubted = np.array([False, True, True, False]), np.array([True, True, False, True])
    of_voxel = np.array([0, 1, 2, 2, 3, 3, -1, -1], np.int32)
    was_there = np.array([True, True, True, False, True, False, True, False])
    labels, sureness = label_voxels(of_voxel, moves, both, stands, doubted, was_there)
    assert labels.tolist() == [D, D, S, S, U, U, S, U]
    assert sureness.tolist() == [AGREED, ALONE, AGREED, ALONE, UNSURE, UNSURE, ALONE, UNSURE]


def test_points_take_the_label_of_their_voxel_and_ground_that_of_what_it_touches() -> None:
    said = unlabelled_points(7)
    valid = np.array([0, 2, 3, 4, 6])
    ground = np.array([True, True, True, False, False])
    in_range = np.array([True, False, True, False, False])
    touching = np.array([False, False, True, False, False])
    label_ground(said, valid, ground, in_range, touching, touching)
    labels, sureness = np.array([D, S], np.uint8), np.array([AGREED, ALONE], np.uint8)
    of_voxel, confirmed = np.array([0, -1], np.int32), np.array([True])
    copy_to_points(
        said, valid[3:], np.array([1, 0], np.int32), labels, sureness, of_voxel, confirmed
    )
    assert said.labels.tolist() == [S, U, U, D, S, U, D]
    assert said.sureness.tolist() == [GROUND, UNSURE, UNSURE, ALONE, ALONE, UNSURE, AGREED]
    assert said.cluster.tolist() == [-1, -1, -1, -1, -1, -1, 0]
    assert said.confirmed.tolist() == [False, False, False, True, False, False, True]
    assert said.ground.tolist() == [True, False, True, False, False, False, False]
