"""Ground reattachment: ground points that belong to movers get their mover's label back.

Sills, bumpers and bonnets are as even as a road, so ground removal takes them. No beam passes
through a road, but frames before a mover came saw the street behind its present place.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from schemas.arrays import Mask, Points
from workers.lidar.preprocessing import PreprocessedFrame
from workers.points.neighbours import build_grid, nearest_indices
from workers.points.point_kernels import moved_rows
from workers.points.step_names import step

TOUCHING_M: Final = 0.2
"""Distance between the mean of a voxel's points and those in the next one, metres."""

REACH_M: Final = 0.5
"""Largest gap between points of one body, metres, as in clustering."""

SeenThrough = Callable[[Points], Mask]
"""A function that returns which places other frames saw through."""


@step("reattach")
def reattach_ground(
    prepared: PreprocessedFrame,
    moves: Mask,
    confirmed: Mask,
    ground: Mask,
    seen_through: SeenThrough,
) -> tuple[Mask, Mask]:
    """Find the ground points that touch a mover, or are next to it where frames saw through.

    Args:
        prepared: The frame.
        moves: (V,) voxels that move.
        confirmed: (V,) those that are confirmed.
        ground: (M,) candidate ground points of the frame.
        seen_through: Tests places in odom space against other frames.

    Returns:
        (M,) ground that belongs to a mover, and (M,) to a confirmed one.
    """
    of_mover, of_confirmed = np.zeros((2, len(ground)), np.bool_)
    moving = np.flatnonzero(moves)
    asked = np.flatnonzero(ground)
    if len(moving) == 0 or len(asked) == 0:
        return of_mover, of_confirmed
    grid = build_grid(prepared.voxels.centroids_m[moving], prepared.odom_from_beams[:3, 3])
    places = moved_rows(prepared.points_m, asked, prepared.odom_from_beams)
    nearest = nearest_indices(grid, places, REACH_M)
    within_reach = np.flatnonzero(nearest >= 0)
    asked, places, nearest = asked[within_reach], places[within_reach], nearest[within_reach]
    apart_m = np.linalg.norm(places - grid.points_m[nearest], axis=1)
    belongs = apart_m < TOUCHING_M
    further = np.flatnonzero(~belongs)
    belongs[further] = seen_through(places[further])
    of_mover[asked[belongs]] = True
    of_confirmed[asked[belongs]] = confirmed[moving[grid.order[nearest[belongs]]]]
    return of_mover, of_confirmed
