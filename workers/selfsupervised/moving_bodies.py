"""Moving bodies: pieces inside a mover that neither registration nor free space can decide.

The side of a lorry lies on itself when it is shifted, and its wheels and chassis show other
parts in every frame. Nothing that stands is inside a body that moves.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.points.compiled import compiled
from workers.points.neighbours import PointGrid, build_grid, nearest_indices
from workers.points.step_names import step
from workers.selfsupervised.candidates import GOOD_FIT_FAR_M, LONG_M, MIN_SPEED_M_PER_S
from workers.selfsupervised.motion import ClusterMotions
from workers.selfsupervised.occlusion_fragments import REACH_M
from workers.selfsupervised.registration import Reference
from workers.selfsupervised.tracker import Tracked
from workers.selfsupervised.translation_search import energy_of, refine

MIN_TOUCHING_SHARE: Final = 0.2
"""Share of a piece that is within reach of its mover: a chassis is beneath the load, not next to
it."""

_MIN_TOUCHING_VOXELS: Final = 3
_MIN_OF_MOVER_SHARE: Final = 0.05
_ALONG_M: Final = 0.5
_ASIDE_M: Final = 0.4
_INSIDE_M: Final = 1.5
"""Depth of a long body behind its visible side, metres: every lorry and bus is broader."""

_WORSE_M: Final = 0.03
"""Difference of two energies that counts as equal, metres: voxels of one surface, cut twice."""

_REFINED_M: Final = 0.4
"""Error of the mover's own shift over half a second, metres."""

_SAMPLES: Final = 150
_ICP_STEPS: Final = 8


@step("bodies")
def complete_bodies(
    points_m: Points,
    found: ClusterMotions,
    tracked: Tracked,
    far: Reference,
    *,
    centre_m: NDArray[np.floating],
) -> Tracked:
    """Mark clusters inside the outline of a mover as dynamic, if they fit its motion too.

    A piece is inside if it is between the mover's ends, and between its visible side and 1.5 m
    behind it where the mover is long. It fits if the mover's motion explains the frame half a
    second ago as well as standing does. Parked cars, poles and people do not fit; walls, rails and
    kerbs do, and reach beyond the outline.

    Args:
        points_m: (V, 3) voxel centroids off the ground, odom space.
        found: Their clusters and motions.
        tracked: Dynamic and confirmed clusters.
        far: The frame about 0.5 s ago.
        centre_m: (3,) the sensor, odom space.

    Returns:
        The same with those pieces dynamic, at the velocity of their mover, and confirmed if it is.
    """
    pieces, movers = _pieces(points_m, found, tracked, centre_m)
    velocity = np.where(
        found.registered[:, None], found.velocity_m_per_s, tracked.velocity_m_per_s
    ).astype(np.float32)
    fits = _fits(
        far.grid,
        points_m,
        found.clusters.members,
        found.clusters.start,
        pieces,
        (-far.age_s * velocity[movers]).astype(np.float64),
    )
    dynamic, confirmed = tracked.dynamic.copy(), tracked.confirmed.copy()
    of_cluster = tracked.velocity_m_per_s.copy()
    for piece, mover in zip(pieces[fits], movers[fits], strict=True):
        if _is_inside(points_m, found, piece, mover, velocity[mover], centre_m):
            dynamic[piece], confirmed[piece] = True, tracked.confirmed[mover]
            of_cluster[piece] = velocity[mover]
    return replace(tracked, dynamic=dynamic, confirmed=confirmed, velocity_m_per_s=of_cluster)


def _pieces(
    points_m: Points, found: ClusterMotions, tracked: Tracked, centre_m: NDArray[np.floating]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the clusters that touch a mover and do not move, and the largest mover of each."""
    clusters, k = found.clusters, len(found.clusters)
    nothing = np.zeros(0, np.int64)
    moving = np.flatnonzero(clusters.member_mask(tracked.dynamic))
    members = np.flatnonzero(clusters.member_mask(~tracked.dynamic))
    if len(moving) == 0 or len(members) == 0:
        return nothing, nothing
    grid = build_grid(points_m[moving], centre_m)
    nearest = nearest_indices(grid, points_m[members], REACH_M)
    touching = nearest >= 0
    owner = clusters.of_point[members[touching]].astype(np.int64)
    touched = clusters.of_point[moving[grid.order[nearest[touching]]]].astype(np.int64)
    hits = np.bincount(owner, minlength=k)
    pairs, count = np.unique(owner * k + touched, return_counts=True)
    owner, touched = pairs // max(k, 1), pairs % max(k, 1)
    size = clusters.sizes
    enough = (hits[owner] > MIN_TOUCHING_SHARE * size[owner]) & (
        count >= np.maximum(_MIN_TOUCHING_VOXELS, _MIN_OF_MOVER_SHARE * size[owner])
    )
    owner, touched = owner[enough], touched[enough]
    order = np.lexsort((touched, -size[touched], owner))
    pieces, first = np.unique(owner[order], return_index=True)
    return pieces, touched[order][first]


def _is_inside(
    points_m: Points,
    found: ClusterMotions,
    piece: int,
    mover: int,
    velocity: NDArray[np.float32],
    centre_m: NDArray[np.floating],
) -> bool:
    speed = float(np.hypot(velocity[0], velocity[1]))
    if speed < MIN_SPEED_M_PER_S:
        return False
    ahead = velocity[:2] / speed
    axes = np.array([ahead, (-ahead[1], ahead[0])], np.float32).T
    body = (points_m[found.clusters.of(mover), :2] - centre_m[:2].astype(np.float32)) @ axes
    part = (points_m[found.clusters.of(piece), :2] - centre_m[:2].astype(np.float32)) @ axes
    low, high = body.min(axis=0), body.max(axis=0)
    inside = _INSIDE_M if high[0] - low[0] > LONG_M else 0.0
    beyond = float(body[:, 1].mean())
    low -= np.array([_ALONG_M, _ASIDE_M + (inside if beyond < 0.0 else 0.0)], np.float32)
    high += np.array([_ALONG_M, _ASIDE_M + (inside if beyond > 0.0 else 0.0)], np.float32)
    return bool((part.min(axis=0) >= low).all() and (part.max(axis=0) <= high).all())


@compiled
def _fits(
    grid: PointGrid,
    points: Points,
    members: NDArray[np.int32],
    start: NDArray[np.int32],
    pieces: NDArray[np.int64],
    shifts: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Test which pieces fit an earlier frame after the shift of their mover as well as without."""
    fits = np.zeros(len(pieces), np.bool_)
    for i in range(len(pieces)):
        begin, end = start[pieces[i]], start[pieces[i] + 1]
        n = min(end - begin, _SAMPLES)
        sample = np.empty((n, 3), np.float32)
        for j in range(n):
            sample[j] = points[members[begin + j * (end - begin) // n]]
        rows = np.full(n, -1, np.int32)
        still = energy_of(grid, sample, 0.0, 0.0, 0.0, rows, np.inf)
        rows[:] = -1
        shift = shifts[i].copy()
        refine(grid, sample, shift, rows, _ICP_STEPS)
        aside = np.sqrt((shift[0] - shifts[i, 0]) ** 2 + (shift[1] - shifts[i, 1]) ** 2)
        if aside > _REFINED_M:
            shift[:] = shifts[i]
        rows[:] = -1
        moved = energy_of(grid, sample, shift[0], shift[1], shift[2], rows, np.inf)
        fits[i] = moved <= still + _WORSE_M and moved <= GOOD_FIT_FAR_M
    return fits
