"""Counts in boxes equal those of numpy."""

import numpy as np
import pytest

from workers.contradiction.box_queries import (
    areas_of,
    counts_in_boxes,
    labels_around,
    rows_labelled,
)

RNG = np.random.default_rng(5)


def test_rows_labelled_are_off_the_ground_and_finite() -> None:
    points = RNG.uniform(-5.0, 5.0, (300, 3)).astype(np.float32)
    points[::7, 1], points[::11, 2] = np.nan, np.inf
    labels, ground = RNG.integers(0, 3, 300).astype(np.uint8), RNG.random(300) < 0.4
    wanted = (labels == 1) & ~ground & np.isfinite(points).all(axis=1)
    assert 20 < wanted.sum() < 100
    assert rows_labelled(points, labels, 1, ground).tolist() == np.flatnonzero(wanted).tolist()


def test_each_mask_is_counted_in_turned_boxes() -> None:
    places = RNG.uniform(-3.0, 3.0, (2000, 3))
    agreed, not_refuted = RNG.random(2000) < 0.3, RNG.random(2000) < 0.6
    axes = np.linalg.qr(RNG.normal(size=(4, 3, 3))).Q
    middle, half = RNG.uniform(-2.0, 2.0, (4, 3)), RNG.uniform(0.5, 2.0, (4, 3))
    first, last = np.array([0, 100, 700, 900]), np.array([2000, 1500, 1800, 900])
    found = counts_in_boxes(places, agreed, not_refuted, first, last, middle, axes, half)
    for box in range(4):
        inside = (np.abs((places - middle[box]) @ axes[box]) <= half[box]).all(axis=1)
        inside &= (np.arange(2000) >= first[box]) & (np.arange(2000) < last[box])
        expected = [(inside & agreed).sum(), (inside & not_refuted).sum(), inside.sum()]
        assert found[:, box].tolist() == expected
        assert inside.sum() > 10 or first[box] == last[box]


def test_labels_around_an_object_are_counted_up_to_the_margin() -> None:
    thing = np.array([[0.0, 0.0, 0.0], [2.0, 1.0, 1.0]], np.float32)
    points = np.array([[3.0, 0, 0], [3.01, 0, 0], [1, -1, 2], [1, 1, 2.01]], np.float32)
    counts = labels_around(points, np.array([1, 1, 0, 2], np.uint8), thing, np.float32(1.0))
    assert counts[:3].tolist() == [1, 1, 0]
    assert counts.sum() == 2


def test_areas_are_of_the_rectangles_around() -> None:
    corners = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [0.0, 2.0]])
    cos, sin = np.cos([0.0, np.pi / 4]), np.sin([0.0, np.pi / 4])
    axes = np.array([[cos, sin], [-sin, cos]])
    assert areas_of(corners, axes).tolist() == pytest.approx([8.0, 18.0])
    assert areas_of(corners[:1], axes).tolist() == [0.0, 0.0]
