"""Point kernels: single passes over the points of a frame, without the copies of numpy."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from workers.points.compiled import compiled


@compiled
def returns_within(points: Points, valid: Mask, farthest: np.float32) -> NDArray[np.int64]:
    """Select rows that are valid, finite, and nearer than a distance along every axis; (M,)."""
    index = np.empty(len(points), np.int64)
    count = 0
    for i in range(len(points)):
        if valid[i] and (
            abs(points[i, 0]) < farthest
            and abs(points[i, 1]) < farthest
            and abs(points[i, 2]) < farthest
        ):
            index[count] = i
            count += 1
    return index[:count].copy()


@compiled
def rows_about(points: Points, index: NDArray[np.int64], origin: NDArray[np.float32]) -> Points:
    """Copy selected rows relative to another origin; (M, 3) float32."""
    rows = np.empty((len(index), 3), np.float32)
    for i in range(len(index)):
        for axis in range(3):
            rows[i, axis] = points[index[i], axis] - origin[axis]
    return rows


@compiled
def judged_rows(
    points: Points, ground: Mask, nearest: float, farthest: float, highest: float
) -> NDArray[np.int64]:
    """Select rows off the ground, between two horizontal ranges and not too high; (J,)."""
    index = np.empty(len(points), np.int64)
    count = 0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        squared = x * x + y * y
        inside = squared > nearest * nearest and squared < farthest * farthest
        if inside and not ground[i] and points[i, 2] < highest:
            index[count] = i
            count += 1
    return index[:count].copy()


@compiled
def within(points: Points, nearest: float, farthest: float) -> Mask:
    """Mark rows between two horizontal ranges; (M,)."""
    inside = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        squared = x * x + y * y
        inside[i] = (squared > nearest * nearest) & (squared < farthest * farthest)
    return inside


@compiled
def within_box(points: Points, farthest: float) -> Mask:
    """Mark rows that are no farther than a distance along every axis; (N,)."""
    inside = np.empty(len(points), np.bool_)
    for i in range(len(points)):
        inside[i] = (
            (abs(points[i, 0]) <= farthest)
            & (abs(points[i, 1]) <= farthest)
            & (abs(points[i, 2]) <= farthest)
        )
    return inside


@compiled
def moved_rows(points: Points, index: NDArray[np.int64], to_from_from: Transform) -> Points:
    """Transform selected rows; (J, 3) float32, computed in float64 since poses are large."""
    rows = np.empty((len(index), 3), np.float32)
    pose = to_from_from
    for i in range(len(index)):
        x = np.float64(points[index[i], 0])
        y = np.float64(points[index[i], 1])
        z = np.float64(points[index[i], 2])
        for axis in range(3):
            turned = pose[axis, 0] * x + pose[axis, 1] * y + pose[axis, 2] * z
            rows[i, axis] = turned + pose[axis, 3]
    return rows


@compiled
def moved(points: Points, to_from_from: Transform) -> Points:
    """Transform points; (N, 3) float32, computed in float64."""
    rows = np.empty(points.shape, np.float32)
    pose = to_from_from
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        for axis in range(3):
            turned = pose[axis, 0] * x + pose[axis, 1] * y + pose[axis, 2] * z
            rows[i, axis] = turned + pose[axis, 3]
    return rows


@compiled
def in_centimetres(
    points: Points, valid: Mask, farthest: np.float32, nowhere: np.int16
) -> NDArray[np.int16]:
    """Quantise valid points within a distance along every axis to centimetres; (N, 3)."""
    rows = np.empty(points.shape, np.int16)
    for i in range(len(points)):
        seen = valid[i] and (
            abs(points[i, 0]) <= farthest
            and abs(points[i, 1]) <= farthest
            and abs(points[i, 2]) <= farthest
        )
        for axis in range(3):
            rows[i, axis] = np.rint(points[i, axis] * np.float32(100)) if seen else nowhere
    return rows


@compiled
def first_and_last(values: NDArray[np.int32], valid: Mask) -> tuple[int, int]:
    """Return the least and greatest valid value; the greatest is the lesser where none is valid."""
    first, last = np.int64(1), np.int64(0)
    for i in range(len(values)):
        if valid[i]:
            value = np.int64(values[i])
            first, last = (value, value) if last < first else (min(first, value), max(last, value))
    return int(first), int(last)
