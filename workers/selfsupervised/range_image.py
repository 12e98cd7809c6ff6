"""What the sensor saw in each direction: nearest range per beam and azimuth step."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.selfsupervised.beam_table import BeamTable
from workers.selfsupervised.compiled import compiled

COLUMNS = 1800
"""0.2 degrees: the azimuth step of spinning sensors at 10 Hz; finer steps would leave gaps."""

NEAREST_RETURN_M = 2.0


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
def column_of(x: float, y: float, columns: int) -> int:
    """Column of a direction, from -pi counter-clockwise."""
    column = int((np.arctan2(y, x) + np.pi) * (columns / (2.0 * np.pi)))
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
def _project(
    points: Points, tangents: NDArray[np.float32], max_gap: np.float32
) -> NDArray[np.float32]:
    rows = len(tangents)
    image = np.zeros((rows, COLUMNS), np.float32)
    if rows == 0:
        return image
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        across = np.sqrt(x * x + y * y)
        distance = np.sqrt(x * x + y * y + z * z)
        if distance < NEAREST_RETURN_M:
            continue
        tangent = z / max(across, np.float32(1e-3))
        row = row_above(tangents, tangent)
        if row == rows or (row > 0 and tangent - tangents[row - 1] < tangents[row] - tangent):
            row -= 1
        if abs(tangents[row] - tangent) > max_gap:
            continue
        column = column_of(x, y, COLUMNS)
        if image[row, column] == 0.0 or distance < image[row, column]:
            image[row, column] = distance
    return image
