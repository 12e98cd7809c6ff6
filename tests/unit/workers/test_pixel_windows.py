"""Loops over the windows of a range image, against plain numpy."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from workers.lidar.pixel_windows import (
    argmax_code,
    look_up,
    majority_code,
    mean_of,
    mixed_windows,
    nearest_in_window,
    padded,
)

ROWS, COLUMNS, POINTS = 8, 40, 700
DISCOUNT = np.linspace(0.5, 1.0, 25, dtype=np.float32).reshape(5, 5)


def image(seed: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Ranges on a coarse grid, so that many are equally far, and pixels of which some are empty."""
    rng = np.random.default_rng(seed)
    range_m = (rng.integers(0, 24, (ROWS, COLUMNS)) / 8 + 5).astype(np.float32)
    return range_m, rng.integers(-1, 3, (ROWS, COLUMNS)).astype(np.int32)


@pytest.mark.parametrize("wrap", [True, False])
@pytest.mark.parametrize("fill", [np.inf, 0.0])
def test_the_nearest_are_those_of_a_full_sort(wrap: bool, fill: float) -> None:
    range_m, index = image(1)
    rng = np.random.default_rng(2)
    row = rng.integers(0, ROWS, POINTS).astype(np.int32)
    column = rng.integers(0, COLUMNS, POINTS).astype(np.int32)
    own = (rng.integers(0, 24, POINTS) / 8 + (1 if fill == 0 else 5)).astype(np.float32)
    points = np.flatnonzero(rng.random(POINTS) < 0.7)
    wide = padded(range_m, index, 2, np.float32(fill), wrap)
    found = nearest_in_window(wide, row, column, own, points, DISCOUNT, 5, np.float32(1.0), wrap)
    sides = {"mode": "wrap"} if wrap else {"constant_values": -1}
    flat = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    flat = np.pad(flat, ((2, 2), (0, 0)), constant_values=-1)
    flat = np.pad(flat, ((0, 0), (2, 2)), **sides)
    for at, i in enumerate(points):
        window = (slice(row[i], row[i] + 5), slice(column[i], column[i] + 5))
        apart = np.abs(wide[window] - own[i]) * DISCOUNT
        apart[2, 2] = 0
        order = np.argsort(apart.ravel(), kind="stable")[:5]
        near = apart.ravel()[order] <= 1
        expected = np.where(near, flat[window].ravel()[order], -1)
        np.testing.assert_array_equal(found[at], expected)
    assert (found < 0).any()


@pytest.mark.parametrize("nobody", [0, 1])
def test_the_commonest_code_wins_and_of_equals_the_lowest(nobody: int) -> None:
    rng = np.random.default_rng(3)
    codes = rng.integers(0, 4, (ROWS, COLUMNS)).astype(np.uint8)
    voters = rng.integers(-1, codes.size, (300, 5)).astype(np.int32)
    voters[:9] = -1
    ballots = np.where(voters >= 0, codes.ravel()[voters], 0)
    counts = (ballots[:, :, None] == np.arange(4)).sum(axis=1)
    counts[:, 0] = 0
    expected = np.where(counts.any(axis=1), counts.argmax(axis=1), nobody)
    np.testing.assert_array_equal(majority_code(codes, voters, np.uint8(nobody)), expected)


def test_a_mean_is_over_those_who_vote_and_a_point_without_pixel_has_nothing() -> None:
    values, _ = image(4)
    voters = np.array([[0, 1, -1], [-1, -1, -1], [5, 5, 7]], np.int32)
    flat = values.ravel().astype(np.float64)
    expected = [(flat[0] + flat[1]) / 2, 0, (2 * flat[5] + flat[7]) / 3]
    np.testing.assert_array_equal(mean_of(values, voters), np.array(expected, np.float32))
    own = np.array([3, -1], np.int32)
    assert look_up(values, own, np.float32(7)).tolist() == [flat[3], 7]


@pytest.mark.parametrize("wrap", [True, False])
def test_windows_are_mixed_where_filters_say_so(wrap: bool) -> None:
    rng = np.random.default_rng(5)
    _, index = image(5)
    codes = np.repeat(rng.integers(0, 4, COLUMNS // 10), 10).astype(np.uint8)
    codes = np.tile(codes, (ROWS, 1))
    codes[0, :10] = 3 - codes[0, :10]
    mode = ("nearest", "wrap" if wrap else "nearest")
    highest = ndimage.maximum_filter(np.where(index >= 0, codes, 0), 5, mode=mode)
    lowest = ndimage.minimum_filter(np.where(index >= 0, codes, 255), 5, mode=mode)
    expected = (highest != lowest) | (lowest == 0)
    assert expected.any()
    assert not expected.all()
    np.testing.assert_array_equal(mixed_windows(codes, index, 2, wrap), expected)


def test_the_likeliest_is_the_first_of_the_greatest() -> None:
    values = np.random.default_rng(5).integers(0, 4, (7, 300)).astype(np.float32) / np.float32(4)
    assert np.array_equal(argmax_code(values), values.argmax(axis=0) + 1)
