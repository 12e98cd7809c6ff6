"""Pixel of each point in a range image, compiled: a fast path, and a mark for points near edges."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask
from workers.lidar.spherical import ANGLE_ERROR, BLOCK, angle_of
from workers.points.compiled import compiled

UNSURE: Final = -2
"""Row of a point so close to the edge of a pixel that the library function must decide."""

_STEPS = 2048
"""Even steps through the edges of rows; most of them contain one edge at most."""

_SINE_ERROR = 3e-6
"""Error of an elevation's sine in 32 bits: six times that of the library's sine and of row shares.
"""


class Gaps(NamedTuple):
    """Rows between edges of elevation.

    Attributes:
        sines: (E,) of the edges, rising.
        row: (E + 1,) row below the first edge, between two, and above the last; -1 for none.
        first: (_STEPS + 1,) first edge that a sine of each even step may be below.
    """

    sines: NDArray[np.float64]
    row: NDArray[np.int32]
    first: NDArray[np.int32]


def gaps_between(edges_rad: NDArray[np.float64], row: NDArray[np.int32]) -> Gaps:
    """Build the search table of `place_points` from rising row edges and the rows between them."""
    sines = np.sin(edges_rad)
    begins = np.linspace(sines[0], sines[-1], _STEPS + 1)
    # a little lower, by more than the rounding
    first = np.searchsorted(sines, begins - 0.01 * (sines[-1] - sines[0]) / _STEPS)
    return Gaps(sines, row, np.minimum(first, len(sines) - 1).astype(np.int32))


@compiled
def place_points(
    points: NDArray[np.floating],
    valid: Mask,
    nearest: np.floating,
    farthest: np.floating,
    gaps: Gaps,
    columns: int,
    range_m: NDArray[np.floating],
    row: NDArray[np.int32],
    column: NDArray[np.int32],
) -> None:
    """Compute range, row and column of points, in the precision of the points.

    Args:
        points: (N, 3) sensor space, metres.
        valid: (N,) points that may be placed.
        nearest: Largest range that is too near, metres.
        farthest: Smallest range that is too far, metres.
        gaps: Edges of rows.
        columns: Width of the image.
        range_m: (N,) filled with ranges; 0 where a point is not placed.
        row: (N,) filled with rows; -1 for none, `UNSURE` too close to an edge.
        column: (N,) filled with columns, where there is a row.
    """
    sines, scale = gaps.sines, _STEPS / (gaps.sines[-1] - gaps.sines[0])
    per_rad = columns / (2.0 * np.pi)
    close = ANGLE_ERROR * per_rad
    sine, at = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    for begin in range(0, len(points), BLOCK):
        n = min(BLOCK, len(points) - begin)
        for k in range(n):  # without a branch, for vector instructions
            i = begin + k
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            away = np.sqrt(x * x + y * y + z * z)
            range_m[i] = away
            sine[k] = z / away
            at[k] = angle_of(np.float32(x), np.float32(y))
        for k in range(n):
            i = begin + k
            row[i], column[i] = -1, -1
            if not (valid[i] and nearest < range_m[i] < farthest):
                range_m[i] = 0.0
                continue
            up = np.float64(sine[k])
            edge = gaps.first[int(min(max((up - sines[0]) * scale, 0.0), np.float64(_STEPS)))]
            while edge < len(sines) and sines[edge] < up:
                edge += 1
            sure = edge == 0 or up - sines[edge - 1] > _SINE_ERROR
            sure &= edge == len(sines) or sines[edge] - up > _SINE_ERROR
            if sure and gaps.row[edge] < 0:
                continue
            across = 0.5 * columns - np.float64(at[k]) * per_rad
            column[i] = int(across)
            apart = across - column[i]
            row[i] = gaps.row[edge] if sure and close < apart < 1.0 - close else UNSURE


@compiled
def nearest_of_pixels(
    row: NDArray[np.int32],
    column: NDArray[np.int32],
    range_m: NDArray[np.floating],
    index: NDArray[np.int32],
    depth: NDArray[np.floating],
) -> None:
    """Keep the nearest point of each pixel, of equally near ones the first.

    Args:
        row: (N,) of each point, -1 for none.
        column: (N,) of each point.
        range_m: (N,) of each point.
        index: (H, W) of -1; filled with the point of each pixel.
        depth: (H, W) of -1; filled with the range of that point.
    """
    for i in range(len(row)):
        if row[i] >= 0:
            shown = index[row[i], column[i]]
            if shown < 0 or range_m[i] < depth[row[i], column[i]]:
                index[row[i], column[i]] = i
                depth[row[i], column[i]] = range_m[i]


@compiled
def normalised(
    index: NDArray[np.int32],
    least: int,
    range_m: NDArray[np.float32],
    points: NDArray[np.float32],
    intensity: NDArray[np.float32],
    means: NDArray[np.float32],
    stds: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Normalise range, x, y, z and intensity of the point in each pixel by means and deviations.

    Args:
        index: (H, W) point of each pixel.
        least: Pixels of a lower index are empty.
        range_m: (N,) of each point.
        points: (N, 3) metres.
        intensity: (N,).
        means: (5,).
        stds: (5,).

    Returns:
        (5, H, W) float32; zero in empty pixels.
    """
    rows, columns = index.shape
    channels = np.zeros((5, rows, columns), np.float32)
    for row in range(rows):
        for column in range(columns):
            i = index[row, column]
            if i >= least:
                channels[0, row, column] = (range_m[i] - means[0]) / stds[0]
                for axis in range(3):
                    value = points[i, axis] - means[1 + axis]
                    channels[1 + axis, row, column] = value / stds[1 + axis]
                channels[4, row, column] = (intensity[i] - means[4]) / stds[4]
    return channels
