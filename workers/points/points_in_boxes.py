"""Points in oriented boxes that may move: one pass over the points, by cells over the ground."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.compiled import compiled

CELL_M: Final = 4.0
"""Side of a cell over the ground, metres: a car is in two or three."""

CELLS: Final = 128
"""Cells along an axis: 256 m to each side; boxes and points beyond it are not compared."""


@compiled
def points_in_boxes(
    points: Points,
    time_s: NDArray[np.float32],
    centre: NDArray[np.float64],
    sensor_from_box: NDArray[np.float64],
    half: NDArray[np.float64],
    velocity: NDArray[np.float64],
    margin: float,
    bottom: float,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Find the box that each point is in, and the box that it is next to.

    A point is in a box from `bottom` above its lower face on. It is next to one below that, where
    the ground is, or up to `margin` outside. Of several boxes the one counts whose centre is
    nearest in units of its own size.

    Args:
        points: (N, 3) sensor space, metres.
        time_s: (N,) time of each point after the boxes, seconds.
        centre: (B, 3) centres, metres.
        sensor_from_box: (B, 3, 3) rotations.
        half: (B, 3) half of length, width and height, metres.
        velocity: (B, 3) metres per second in sensor space; zero where unknown.
        margin: Metres around a box.
        bottom: Metres above its lower face.

    Returns:
        (N,) index of the box a point is in, and (N,) of the box it is next to; -1 for none.
    """
    first, members = _cells_of(centre, half, velocity, time_s, margin)
    inside = np.full(len(points), -1, np.int32)
    near = np.full(len(points), -1, np.int32)
    reach = 0.5 * CELLS * CELL_M
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not (abs(x) < reach and abs(y) < reach):
            continue
        cell = int((y + reach) / CELL_M) * CELLS + int((x + reach) / CELL_M)
        best = np.inf
        best_near = np.inf
        for k in range(first[cell], first[cell + 1]):
            b = members[k]
            t = time_s[i]
            dx = x - centre[b, 0] - t * velocity[b, 0]
            dy = y - centre[b, 1] - t * velocity[b, 1]
            dz = z - centre[b, 2] - t * velocity[b, 2]
            turned = sensor_from_box[b]
            u = dx * turned[0, 0] + dy * turned[1, 0] + dz * turned[2, 0]
            if abs(u) > half[b, 0] + margin:
                continue
            v = dx * turned[0, 1] + dy * turned[1, 1] + dz * turned[2, 1]
            if abs(v) > half[b, 1] + margin:
                continue
            w = dx * turned[0, 2] + dy * turned[1, 2] + dz * turned[2, 2]
            if abs(w) > half[b, 2] + margin:
                continue
            depth = max(abs(u) / half[b, 0], abs(v) / half[b, 1], abs(w) / half[b, 2])
            if depth <= 1.0 and w >= bottom - half[b, 2]:
                if depth < best:
                    best = depth
                    inside[i] = b
            elif depth < best_near:
                best_near = depth
                near[i] = b
    return inside, near


@compiled
def _cells_of(
    centre: NDArray[np.float64],
    half: NDArray[np.float64],
    velocity: NDArray[np.float64],
    time_s: NDArray[np.float32],
    margin: float,
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """List the boxes that may contain a point of each cell; row-wise offsets, and the boxes."""
    longest = 0.0
    for i in range(len(time_s)):
        longest = max(longest, abs(float(time_s[i])))
    bounds = np.empty((len(centre), 4), np.int64)
    first = np.zeros(CELLS * CELLS + 1, np.int64)
    for b in range(len(centre)):
        radius = margin + np.sqrt(half[b, 0] ** 2 + half[b, 1] ** 2 + half[b, 2] ** 2)
        for axis in range(2):
            wide = radius + longest * abs(velocity[b, axis])
            low = np.floor((centre[b, axis] - wide) / CELL_M) + CELLS // 2
            high = np.floor((centre[b, axis] + wide) / CELL_M) + CELLS // 2
            bounds[b, 2 * axis] = int(min(max(low, 0.0), float(CELLS)))
            bounds[b, 2 * axis + 1] = int(min(max(high, -1.0), CELLS - 1.0))
        for row in range(bounds[b, 2], bounds[b, 3] + 1):
            for column in range(bounds[b, 0], bounds[b, 1] + 1):
                first[row * CELLS + column + 1] += 1
    for cell in range(CELLS * CELLS):
        first[cell + 1] += first[cell]
    members = np.empty(first[CELLS * CELLS], np.int32)
    at = first[:-1].copy()
    for b in range(len(centre)):
        for row in range(bounds[b, 2], bounds[b, 3] + 1):
            for column in range(bounds[b, 0], bounds[b, 1] + 1):
                cell = row * CELLS + column
                members[at[cell]] = b
                at[cell] += 1
    return first, members
