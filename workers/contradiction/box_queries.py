"""How many places lie in boxes, compiled: none is copied to be asked."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Labels, Mask, Points
from workers.points.compiled import compiled

Counts = NDArray[np.int64]
Places = NDArray[np.float64]


@compiled
def rows_said(points: Points, said: Labels, wanted: int, ground: Mask) -> Counts:
    """Rows off the ground of which something is said, and that are somewhere; (M,)."""
    index = np.empty(len(said), np.int64)
    count = 0
    for i in range(len(said)):
        if said[i] == wanted and not ground[i]:
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            if np.isfinite(x) and np.isfinite(y) and np.isfinite(z):
                index[count] = i
                count += 1
    return index[:count].copy()


@compiled
def counts_in_boxes(
    places: Places,
    agreed: Mask,
    undenied: Mask,
    first: Counts,
    last: Counts,
    middle: Places,
    axes: Places,
    half: Places,
) -> Counts:
    """Count places of three sorts in boxes.

    Args:
        places: (M, 3) metres.
        agreed: (M,) of the first sort.
        undenied: (M,) of the second; all are of the third.
        first: (R,) which places are asked about each box: from here on.
        last: (R,) and before here.
        middle: (R, 3) of the boxes.
        axes: (R, 3, 3) their axes, as columns.
        half: (R, 3) half their sizes; what lies on a side is inside.

    Returns:
        (3, R) counts.
    """
    counts = np.zeros((3, len(first)), np.int64)
    for r in range(len(first)):
        for i in range(first[r], last[r]):
            x, y = places[i, 0] - middle[r, 0], places[i, 1] - middle[r, 1]
            z = places[i, 2] - middle[r, 2]
            inside = True
            for axis in range(3):
                along = x * axes[r, 0, axis] + y * axes[r, 1, axis] + z * axes[r, 2, axis]
                if abs(along) > half[r, axis]:
                    inside = False
                    break
            if inside:
                counts[0, r] += agreed[i]
                counts[1, r] += undenied[i]
                counts[2, r] += 1
    return counts


@compiled
def answers_around(points: Points, answers: Labels, thing: Points, margin: np.float32) -> Counts:
    """Count the answers about points in the upright box around a thing, and its margin.

    Args:
        points: (M, 3) metres.
        answers: (M,) about each.
        thing: (N, 3) what the box is put around, N >= 1.
        margin: Metres on every side; what lies on its edge is inside.

    Returns:
        (256,) points of each answer.
    """
    low, high = thing[0].copy(), thing[0].copy()
    for i in range(len(thing)):
        for axis in range(3):
            low[axis], high[axis] = min(low[axis], thing[i, axis]), max(high[axis], thing[i, axis])
    for axis in range(3):
        low[axis], high[axis] = low[axis] - margin, high[axis] + margin
    counts = np.zeros(256, np.int64)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if low[0] <= x <= high[0] and low[1] <= y <= high[1] and low[2] <= z <= high[2]:
            counts[answers[i]] += 1
    return counts


@compiled
def areas_of(places: Places, axes: Places) -> Places:
    """(H,) areas of the rectangles around places (N, 2), N >= 1, whose sides are axes (2, 2, H)."""
    areas = np.ones(axes.shape[2], np.float64)
    for heading in range(axes.shape[2]):
        for side in range(2):
            x, y = axes[side, 0, heading], axes[side, 1, heading]
            low = high = places[0, 0] * x + places[0, 1] * y
            for i in range(1, len(places)):
                along = places[i, 0] * x + places[i, 1] * y
                low, high = min(low, along), max(high, along)
            areas[heading] *= high - low
    return areas
