"""Box queries: compiled counts of points in boxes, which copy no point."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Labels, Mask, Points
from workers.points.compiled import compiled

Counts = NDArray[np.int64]
Places = NDArray[np.float64]


@compiled
def rows_labelled(points: Points, labels: Labels, wanted: int, ground: Mask) -> Counts:
    """Return the rows (M,) with a given label that are off the ground and have a finite place."""
    index = np.empty(len(labels), np.int64)
    count = 0
    for i in range(len(labels)):
        if labels[i] == wanted and not ground[i]:
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            if np.isfinite(x) and np.isfinite(y) and np.isfinite(z):
                index[count] = i
                count += 1
    return index[:count].copy()


@compiled
def counts_in_boxes(
    places: Places,
    agreed: Mask,
    not_refuted: Mask,
    first: Counts,
    last: Counts,
    middle: Places,
    axes: Places,
    half: Places,
) -> Counts:
    """Count the agreed, the not refuted and all places in oriented boxes.

    Args:
        places: (M, 3) metres.
        agreed: (M,) mask of the first count.
        not_refuted: (M,) mask of the second count; the third counts all places.
        first: (R,) first row of the places that are searched for each box.
        last: (R,) end of these rows, exclusive.
        middle: (R, 3) centres of the boxes, metres.
        axes: (R, 3, 3) axes of the boxes, as columns.
        half: (R, 3) half sizes, metres; a place on a face is inside.

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
                counts[1, r] += not_refuted[i]
                counts[2, r] += 1
    return counts


@compiled
def labels_around(points: Points, labels: Labels, thing: Points, margin: np.float32) -> Counts:
    """Count the labels of points in the axis-aligned box around an object, with a margin.

    Args:
        points: (M, 3) metres.
        labels: (M,) label of each point.
        thing: (N, 3) points of the object that the box encloses, metres; N >= 1.
        margin: Distance by which each face is moved outwards, metres; a point on a face is inside.

    Returns:
        (256,) number of points with each label.
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
            counts[labels[i]] += 1
    return counts


@compiled
def areas_of(places: Places, axes: Places) -> Places:
    """Return the areas (H,) of rectangles around places (N, 2), N >= 1, along axes (2, 2, H)."""
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
