"""What the sensor saw in each direction: nearest range per beam and azimuth step."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.selfsupervised.beam_table import BeamTable
from workers.selfsupervised.compiled import compiled
from workers.selfsupervised.steps import step

COLUMNS = 1800
"""0.2 degrees: the azimuth step of spinning sensors at 10 Hz; finer steps would leave gaps."""

NEAREST_RETURN_M = 2.0

_ATAN = tuple(
    np.float32(c)
    for c in (0.99997726, -0.33262347, 0.19354346, -0.11643287, 0.05265332, -0.01172120)
)
_QUARTER, _HALF, _TINY = np.float32(np.pi / 2), np.float32(np.pi), np.float32(1e-30)
_ANGLE_ERROR = 3e-5
"""Ten times what the polynomial errs by, and the rounding of a 32-bit angle a hundred times."""

_STEPS = 1024


@step("range image")
def range_image(points_m: Points, table: BeamTable) -> NDArray[np.float32]:
    """Project a cloud to its nearest range per cell.

    Args:
        points_m: (N, 3) all valid points about the origin of the beams, ground included: ground
            hides and bounds what lies behind it as anything else does.
        table: The beams.

    Returns:
        (R, 1800) range in metres, 0 where nothing came back; rows rise with elevation.
    """
    return _project(points_m, table.tangents, np.float32(table.max_gap))


@compiled
def column_of(x: np.float32, y: np.float32, columns: int) -> int:
    """Column of a direction, from -pi counter-clockwise.

    The angle is taken from a polynomial, and from the library where that is too close to the edge
    of a column to tell: a quarter of the time, the same columns.
    """
    ax, ay = abs(x), abs(y)
    t = min(ax, ay) / max(max(ax, ay), _TINY)
    s = t * t
    # arctan on [0, 1] to 2e-6 (minimax, odd powers)
    angle = t * (
        _ATAN[0] + s * (_ATAN[1] + s * (_ATAN[2] + s * (_ATAN[3] + s * (_ATAN[4] + s * _ATAN[5]))))
    )
    if ay > ax:
        angle = _QUARTER - angle
    if x < 0:
        angle = _HALF - angle
    if y < 0:
        angle = -angle
    scale = columns / (2.0 * np.pi)
    place = (np.float64(angle) + np.pi) * scale
    column = int(place)
    close = _ANGLE_ERROR * scale
    if place - column < close or place - column > 1.0 - close:
        column = int((np.arctan2(y, x) + np.pi) * scale)
    return min(max(column, 0), columns - 1)


@compiled
def row_above(tangents: NDArray[np.float32], tangent: float) -> int:
    """First row whose tangent is not below the given one; as many as there are rows if none."""
    low, high = 0, len(tangents)
    while low < high:
        middle = (low + high) // 2
        if tangents[middle] < tangent:
            low = middle + 1
        else:
            high = middle
    return low


@compiled
def row_guesses(tangents: NDArray[np.float32]) -> NDArray[np.int32]:
    """First row above each of 1024 even steps through the table, for `guessed_row_above`."""
    guesses = np.zeros(_STEPS, np.int32)
    if len(tangents) > 1:
        step = (tangents[-1] - tangents[0]) / np.float32(_STEPS)
        for k in range(_STEPS):
            guesses[k] = row_above(tangents, float(tangents[0] + step * np.float32(k)))
    return guesses


@compiled
def guessed_row_above(
    tangents: NDArray[np.float32], guesses: NDArray[np.int32], tangent: np.float32
) -> int:
    """The same as `row_above`, from a guess that is right or next to it."""
    rows = len(tangents)
    if rows < 2 or not tangents[0] < tangent <= tangents[-1]:
        return row_above(tangents, float(tangent))
    share = (tangent - tangents[0]) / (tangents[-1] - tangents[0])
    row = int(guesses[min(int(share * np.float32(_STEPS)), _STEPS - 1)])
    while row > 0 and tangents[row - 1] >= tangent:
        row -= 1
    while tangents[row] < tangent:
        row += 1
    return row


@compiled
def _project(
    points: Points, tangents: NDArray[np.float32], max_gap: np.float32
) -> NDArray[np.float32]:
    rows = len(tangents)
    image = np.zeros((rows, COLUMNS), np.float32)
    if rows == 0:
        return image
    guesses = row_guesses(tangents)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        across = np.sqrt(x * x + y * y)
        distance = np.sqrt(x * x + y * y + z * z)
        if distance < NEAREST_RETURN_M:
            continue
        tangent = z / max(across, np.float32(1e-3))
        row = guessed_row_above(tangents, guesses, tangent)
        if row == rows or (row > 0 and tangent - tangents[row - 1] < tangents[row] - tangent):
            row -= 1
        if abs(tangents[row] - tangent) > max_gap:
            continue
        column = column_of(x, y, COLUMNS)
        if image[row, column] == 0.0 or distance < image[row, column]:
            image[row, column] = distance
    return image
