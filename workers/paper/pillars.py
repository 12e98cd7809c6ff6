"""Pillars: upright columns of points, the input of GndNet."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points

LIDAR_HEIGHT_M: Final = 1.733
"""Height of KITTI's sensor over the road, metres; GndNet needs heights over the ground."""


@dataclass(frozen=True, slots=True)
class PillarGrid:
    """Grid of pillars in metres, and the number of points in each; published numbers of GndNet.

    Attributes:
        x_m: Extent forwards, lower bound included.
        y_m: Extent to the left, lower bound included.
        z_m: Extent upwards, over the ground.
        side_m: Side of a pillar.
        max_points: Points of a pillar, at most: the first in the cloud.
        max_pillars: Pillars, at most: the first in the cloud. The published grid has as many cells.
    """

    x_m: tuple[float, float] = (-47.0, 53.0)
    y_m: tuple[float, float] = (-50.0, 50.0)
    z_m: tuple[float, float] = (-4.0, 4.0)
    side_m: float = 1.0
    max_points: int = 100
    max_pillars: int = 10_000

    @property
    def shape(self) -> tuple[int, int]:
        """Return the rows (y) and columns (x) of the grid."""
        return (
            round((self.y_m[1] - self.y_m[0]) / self.side_m),
            round((self.x_m[1] - self.x_m[0]) / self.side_m),
        )


GNDNET_GRID: Final = PillarGrid()


@dataclass(frozen=True, slots=True, eq=False)
class Pillars:
    """The columns of one cloud that have points, in the order of their first point.

    Attributes:
        points: (M, K, 4) float32 x, y, z, intensity of each pillar's points, padded with zeros;
            `workers.paper.gndnet.decorate` adds the encoder's offsets.
        coordinates_zyx: (M, 3) int32 cell of each pillar; z is always 0.
        counts: (M,) int32 points kept.
        grid: Grid of the pillars.
    """

    points: NDArray[np.float32]
    coordinates_zyx: NDArray[np.int32]
    counts: NDArray[np.int32]
    grid: PillarGrid


def pillars(
    points_m: Points,
    intensity: NDArray[np.float32],
    *,
    lidar_height_m: float = LIDAR_HEIGHT_M,
    grid: PillarGrid = GNDNET_GRID,
) -> Pillars:
    """Group a cloud into pillars, as GndNet's loader does.

    As published, a pillar with too many points keeps the first in the cloud, so the result depends
    on the order of the points. The published sensor height is a constant for KITTI's car; here it
    is a parameter.

    Args:
        points_m: (N, 3) sensor space, metres; x forward, y left, z up.
        intensity: (N,) 0 to 1.
        lidar_height_m: Height of the sensor over the ground; added to z.
        grid: Grid of the pillars.

    Returns:
        The pillars that have points; z of their points is over the ground.
    """
    raised = np.column_stack((points_m, intensity)).astype(np.float32)
    raised[:, 2] += np.float32(lidar_height_m)
    low = np.array([grid.x_m[0], grid.y_m[0], grid.z_m[0]], np.float32)
    sizes = np.array([grid.side_m, grid.side_m, grid.z_m[1] - grid.z_m[0]], np.float32)
    rows, columns = grid.shape
    with np.errstate(invalid="ignore"):
        cell = np.floor((raised[:, :3] - low) / sizes)
        inside = ((cell >= 0) & (cell < (columns, rows, 1))).all(axis=1)
    raised, cell = raised[inside], cell[inside].astype(np.int32)
    _, first, place = np.unique(
        cell[:, 1] * columns + cell[:, 0], return_index=True, return_inverse=True
    )
    by_first = np.argsort(first, kind="stable")
    pillar = np.argsort(by_first, kind="stable")[place]
    kept = min(len(first), grid.max_pillars)
    order = np.argsort(pillar, kind="stable")
    start = np.searchsorted(pillar[order], np.arange(len(first) + 1))
    rank = np.arange(len(order)) - start[pillar[order]]
    keep = (rank < grid.max_points) & (pillar[order] < kept)
    packed = np.zeros((kept, grid.max_points, 4), np.float32)
    packed[pillar[order][keep], rank[keep]] = raised[order[keep]]
    of_first = cell[first[by_first[:kept]]]
    coordinates = np.stack((np.zeros(kept, np.int32), of_first[:, 1], of_first[:, 0]), axis=1)
    counts = np.minimum(np.diff(start)[:kept], grid.max_points).astype(np.int32)
    return Pillars(packed, coordinates, counts, grid)
