"""How many points of a cloud lie in and close around each point: what an instance stands in."""

import itertools
from typing import Final

import numpy as np
from numpy.typing import NDArray

_BLOCK: Final = tuple(itertools.product((-1, 0, 1), repeat=3))


def neighbours(
    points_m: NDArray[np.float32],
    clouds_m: tuple[NDArray[np.float32], ...],
    *,
    cell_m: float,
) -> tuple[NDArray[np.int64], ...]:
    """Count the points of each cloud in the block of three cells each way around every point.

    Cells instead of spheres: 27 look-ups per occupied cell, whatever the density.

    Args:
        points_m: (N, 3) around these, metres.
        clouds_m: Clouds to count, (M, 3) each, same space.
        cell_m: Side of a cell.

    Returns:
        (N,) counts for each cloud.
    """
    if not len(points_m):
        return tuple(np.zeros(0, dtype=np.int64) for _ in clouds_m)
    step = (1 << 42, 1 << 21, 1)  # a million cells each way: 400 km at 0.4 m

    def keys(cloud_m: NDArray[np.float32]) -> NDArray[np.int64]:
        # Column by column: numpy is slow along an axis of three.
        key = np.full(len(cloud_m), sum(step) << 20, dtype=np.int64)
        for axis in range(3):
            key += np.floor(cloud_m[:, axis] / cell_m).astype(np.int64) * step[axis]
        return key

    places, place = np.unique(keys(points_m), return_inverse=True)
    counts = []
    for cloud_m in clouds_m:
        occupied, occupants = np.unique(keys(cloud_m), return_counts=True)
        total = np.zeros(len(places), dtype=np.int64)
        for offset in _BLOCK if len(occupied) else ():
            wanted = places + int(np.dot(offset, step))
            at = np.minimum(np.searchsorted(occupied, wanted), len(occupied) - 1)
            total += np.where(occupied[at] == wanted, occupants[at], 0)
        counts.append(total[place])
    return tuple(counts)
