"""Range image of a frame over its own beams: nearest range per beam and azimuth step."""

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.lidar.beam_table import BeamTable
from workers.lidar.spherical import (
    BLOCK,
    column_of,
    columns_of_block,
    new_block,
    project_block,
    row_above,
    rows_of_steps,
)
from workers.points.compiled import compiled
from workers.points.step_names import step

COLUMNS = 1800
"""Columns of the image: an azimuth step of 0.2 degrees, that of spinning sensors at 10 Hz; finer
steps would leave gaps."""

NEAREST_RETURN_M = 2.0


@step("range image")
def range_image(points_m: Points, table: BeamTable) -> NDArray[np.float32]:
    """Project a cloud to its nearest range per cell.

    Args:
        points_m: (N, 3) all valid points about the origin of the beams, ground included, since
            ground also hides and bounds the space behind it.
        table: The beams.

    Returns:
        (R, 1800) range in metres, 0 without a return; rows rise with elevation.
    """
    return _project(points_m, table.tangents, np.float32(table.max_gap))


@compiled
def _project(
    points: Points, tangents: NDArray[np.float32], max_gap: np.float32
) -> NDArray[np.float32]:
    rows = len(tangents)
    image = np.zeros((rows, COLUMNS), np.float32)
    if rows == 0:
        return image
    block, steps = new_block(), rows_of_steps(tangents)
    for first in range(0, len(points), BLOCK):
        n = min(BLOCK, len(points) - first)
        for k in range(n):
            block.x[k] = points[first + k, 0]
            block.y[k] = points[first + k, 1]
            block.z[k] = points[first + k, 2]
        project_block(block, n, tangents, steps)
        columns_of_block(block, n, COLUMNS)
        for k in range(n):
            distance, tangent = block.distance[k], block.tangent[k]
            if distance < NEAREST_RETURN_M:
                continue
            row = row_above(tangents, block.row[k], tangent)
            if row == rows or (row > 0 and tangent - tangents[row - 1] < tangents[row] - tangent):
                row -= 1
            if abs(tangents[row] - tangent) > max_gap:
                continue
            column = column_of(block.column[k], block.x[k], block.y[k], COLUMNS)
            if image[row, column] == 0.0 or distance < image[row, column]:
                image[row, column] = distance
    return image
