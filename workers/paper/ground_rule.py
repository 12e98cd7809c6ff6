"""Ground rule of the paper: points above GndNet's elevation map are off the ground."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.lidar.fidelity import Form
from workers.paper.pillars import GNDNET_GRID, LIDAR_HEIGHT_M, PillarGrid

OUTSIDE: Final = -1
GROUND: Final = 0
NOT_GROUND: Final = 1

ABOVE_GROUND_M: Final = 0.2
"""Height above the map up to which points are ground, metres; published."""

_PAPER_ORIGIN_M: Final = -50.0


def ground_labels(
    points_m: Points,
    elevation_m: NDArray[np.floating],
    *,
    lidar_height_m: float = LIDAR_HEIGHT_M,
    grid: PillarGrid = GNDNET_GRID,
    form: Form = Form.CORRECTED,
) -> NDArray[np.int8]:
    """Compare each point with the elevation of its cell.

    The corrected form differs from the published code in this:

    - the map is read at the network's own origin, x = -47 m (published: -50 m, an offset of 3 m);
    - all cells count (published: those of the first row and column are outside).

    Args:
        points_m: (N, 3) sensor space, metres.
        elevation_m: (R, C) height of the ground over the road below the sensor, rows by y.
        lidar_height_m: Height of the sensor over the ground; added to z.
        grid: Grid of the map.
        form: Corrected or published form.

    Returns:
        (N,) int8 `OUTSIDE` of the map, `GROUND` or `NOT_GROUND`.

    Raises:
        ValueError: If the map is not as large as the grid.
    """
    rows, columns = grid.shape
    if elevation_m.shape != (rows, columns):
        raise ValueError(f"elevation must be {(rows, columns)}, got {elevation_m.shape}")
    paper = form is Form.PAPER
    x_origin_m = _PAPER_ORIGIN_M if paper else grid.x_m[0]
    y_origin_m = _PAPER_ORIGIN_M if paper else grid.y_m[0]
    side = np.float32(grid.side_m)
    first = 1 if paper else 0
    with np.errstate(invalid="ignore"):
        column = np.floor((points_m[:, 0] - np.float32(x_origin_m)) / side)
        row = np.floor((points_m[:, 1] - np.float32(y_origin_m)) / side)
        inside = (column >= first) & (column < columns) & (row >= first) & (row < rows)
    labels = np.full(len(points_m), OUTSIDE, dtype=np.int8)
    height_m = points_m[inside, 2] + np.float32(lidar_height_m)
    ground_m = elevation_m[row[inside].astype(np.intp), column[inside].astype(np.intp)]
    labels[inside] = np.where(height_m > ground_m + ABOVE_GROUND_M, NOT_GROUND, GROUND)
    return labels
