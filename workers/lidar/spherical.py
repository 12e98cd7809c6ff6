"""Spherical coordinates of places in a sensor's image, vectorised: range, row and column.

Loops over blocks of places without a branch compile to vector instructions; steps with a branch
per place follow in separate loops.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.compiled import compiled

BLOCK = 512
"""Places at a time: a block stays in the nearest cache."""

STEPS = 2048
"""Even steps through the table of beams; most of them contain one beam at most."""

_ATAN = tuple(
    np.float32(c)
    for c in (0.99997726, -0.33262347, 0.19354346, -0.11643287, 0.05265332, -0.01172120)
)
_QUARTER, _HALF, _TINY = np.float32(np.pi / 2), np.float32(np.pi), np.float32(1e-30)
ANGLE_ERROR = 3e-5
"""Error of an azimuth, rad: ten times that of the polynomial, a hundred times that of rounding."""

_NEAREST = np.float32(1e-3)


class Block(NamedTuple):
    """Up to `BLOCK` places about the origin of the beams, float32 in all fields but `row`.

    Attributes:
        x: Forward, metres.
        y: To the left.
        z: Up.
        across: Horizontal distance.
        distance: Distance.
        tangent: Of the elevation.
        angle: Azimuth to 3e-5 rad, counter-clockwise from -pi.
        row: (BLOCK,) int32, for `row_above`: a row of the table not above the right one.
        column: (BLOCK,) int32, filled by `columns_of_block`; -1 too close to the edge of a column.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    z: NDArray[np.float32]
    across: NDArray[np.float32]
    distance: NDArray[np.float32]
    tangent: NDArray[np.float32]
    angle: NDArray[np.float32]
    row: NDArray[np.int32]
    column: NDArray[np.int32]


@compiled
def new_block() -> Block:
    """Allocate a block."""
    room, whole = np.zeros((7, BLOCK), np.float32), np.zeros((2, BLOCK), np.int32)
    return Block(room[0], room[1], room[2], room[3], room[4], room[5], room[6], whole[0], whole[1])


@compiled
def fill_block(block: Block, points: Points, first: int, pose: NDArray[np.float32]) -> int:
    """Fill a block with places from `first` on, moved by a (3, 4) pose; return their number."""
    n = min(BLOCK, len(points) - first)
    a, b, c, d = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
    for k in range(n):
        px, py, pz = points[first + k, 0], points[first + k, 1], points[first + k, 2]
        block.x[k] = a * px + b * py + c * pz + d
    a, b, c, d = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
    for k in range(n):
        px, py, pz = points[first + k, 0], points[first + k, 1], points[first + k, 2]
        block.y[k] = a * px + b * py + c * pz + d
    a, b, c, d = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    for k in range(n):
        px, py, pz = points[first + k, 0], points[first + k, 1], points[first + k, 2]
        block.z[k] = a * px + b * py + c * pz + d
    return n


@compiled
def angle_of(x: np.float32, y: np.float32) -> np.float32:
    """Compute the azimuth to `ANGLE_ERROR`, counter-clockwise from -pi, without a branch."""
    ax, ay = abs(x), abs(y)
    less, more = ax if ax < ay else ay, ax if ax > ay else ay
    t = less / (more if more > _TINY else _TINY)
    s = t * t
    # arctan on [0, 1] to 2e-6 (minimax, odd powers)
    angle = t * (
        _ATAN[0] + s * (_ATAN[1] + s * (_ATAN[2] + s * (_ATAN[3] + s * (_ATAN[4] + s * _ATAN[5]))))
    )
    angle = _QUARTER - angle if ay > ax else angle
    angle = _HALF - angle if x < 0 else angle
    return -angle if y < 0 else angle


@compiled
def project_block(
    block: Block, n: int, tangents: NDArray[np.float32], rows: NDArray[np.int32]
) -> None:
    """Compute range, tangent, azimuth and a row of the first n places of a block."""
    for k in range(n):
        x, y, z = block.x[k], block.y[k], block.z[k]
        flat = x * x + y * y
        across = np.sqrt(flat)
        block.across[k] = across
        block.distance[k] = np.sqrt(flat + z * z)
        block.tangent[k] = z / (across if across > _NEAREST else _NEAREST)
    for k in range(n):
        block.angle[k] = angle_of(block.x[k], block.y[k])
    lowest, scale = tangents[0], _steps_per_tangent(tangents)
    for k in range(n):
        at = (block.tangent[k] - lowest) * scale
        at = at if at > np.float32(0.0) else np.float32(0.0)
        block.row[k] = np.int32(at if at < np.float32(STEPS) else np.float32(STEPS))
    for k in range(n):
        # exact where a step contains one beam at most
        row = rows[block.row[k]]
        block.row[k] = row + np.int32(tangents[row] < block.tangent[k])


@compiled
def rows_of_steps(tangents: NDArray[np.float32]) -> NDArray[np.int32]:
    """Return the first row that a tangent of each step may be below, (STEPS + 1,)."""
    rows = np.zeros(STEPS + 1, np.int32)
    scale = np.float64(_steps_per_tangent(tangents))
    row = 0
    for k in range(STEPS + 1):
        # a little lower, by more than the rounding of tangents
        begin = tangents[0] + (k - 0.01) / scale
        while row < len(tangents) - 1 and tangents[row] < begin:
            row += 1
        rows[k] = row
    return rows


@compiled
def row_above(tangents: NDArray[np.float32], guess: int, tangent: np.float32) -> int:
    """Return the first row whose tangent is not below the given one; the row count if none."""
    if not tangent <= tangents[-1]:
        return len(tangents)
    row = guess
    while tangents[row] < tangent:
        row += 1
    return row


@compiled
def columns_of_block(block: Block, n: int, columns: int) -> None:
    """Compute the columns of the first n places of a block, from -pi counter-clockwise."""
    scale = columns / (2.0 * np.pi)
    close = ANGLE_ERROR * scale
    for k in range(n):  # without a branch, for vector instructions
        place = (np.float64(block.angle[k]) + np.pi) * scale
        column = np.int32(place)
        apart = place - column
        sure = (apart >= close) & (apart <= 1.0 - close) & (column < columns)
        block.column[k] = column if sure else np.int32(-1)


@compiled
def column_of(column: int, x: np.float32, y: np.float32, columns: int) -> int:
    """Return the column of a direction, given that of `columns_of_block`.

    The library function decides where the angle is too close to the edge of a column, so the
    columns are the same in a quarter of the time.
    """
    if column < 0:
        scale = columns / (2.0 * np.pi)
        column = int((np.arctan2(y, x) + np.pi) * scale)
        column = min(max(column, 0), columns - 1)
    return int(column)


@compiled
def _steps_per_tangent(tangents: NDArray[np.float32]) -> np.float32:
    span = tangents[-1] - tangents[0]
    return np.float32(STEPS) / (span if span > _TINY else _TINY)
