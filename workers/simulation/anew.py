"""How much of a mover lies where nothing was a second before: what free space can tell of it."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from schemas.arrays import NS_PER_S, Mask, Points
from workers.simulation.lidar import SimulatedFrame

LOOK_BACK_S: Final = 1.0
"""As far as a stream that wants to answer at once can afford to remember."""

PLACE_M: Final = 0.1
REACH_M: Final = 0.3
"""What lies nearer to what was there is not told from it: noise, poses, beams that differ."""


def places_anew(
    frames: Sequence[SimulatedFrame], track: int, *, start_s: float, lasts_s: float
) -> float:
    """Count the places of a mover at which neither it nor anything else was a second before.

    A place that a slow walker took from itself, the side of a long vehicle that its own side was at
    before, and what lies on a wall give nothing away: the fewer places are left, the harder it is
    to see that the thing moves, whoever looks.

    Args:
        frames: Those looked at, evenly in time.
        track: Of the mover.
        start_s: From when on.
        lasts_s: For how long.

    Returns:
        Median over the frames of the stretch that have one a second before, or as long before as
        the first goes back; infinite where none does.
    """
    counts = []
    for now, frame in enumerate(frames):
        if not start_s - 1e-6 <= frame.time_s < start_s + lasts_s - 1e-6:
            continue
        mine = np.flatnonzero(frame.track == track)
        before = _a_second_before(frames, now)
        if before == now or not len(mine):
            continue
        points = _in_world(frames, now, mine)
        cells = np.floor(points[_anew(frames, before, points)] / PLACE_M).astype(np.int64)
        counts.append(len(np.unique(cells, axis=0)))
    return float(np.median(counts)) if counts else np.inf


def _a_second_before(frames: Sequence[SimulatedFrame], now: int) -> int:
    away_s = [abs(frames[now].time_s - each.time_s - LOOK_BACK_S) for each in frames[: now + 1]]
    return int(np.argmin(away_s))


def _anew(frames: Sequence[SimulatedFrame], before: int, points_m: NDArray[np.float64]) -> Mask:
    """Which of (N, 3) points lay free of all returns of an earlier frame."""
    frame = frames[before]
    solid = _in_world(frames, before, np.flatnonzero(frame.ground == 0))
    low, high = points_m.min(axis=0) - REACH_M, points_m.max(axis=0) + REACH_M
    near = solid[((solid >= low) & (solid <= high)).all(axis=1)]
    if not len(near):
        return np.ones(len(points_m), dtype=np.bool_)
    away_m, _ = cKDTree(near).query(points_m, distance_upper_bound=REACH_M)
    anew: Mask = np.isinf(away_m)
    return anew


def _in_world(
    frames: Sequence[SimulatedFrame], which: int, index: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Places of some points of a frame, (N, 3), each from where its beam was fired."""
    frame = frames[which]
    points: Points = frame.points_m[index]
    pose = frame.world_from_sensor
    world = points @ pose[:3, :3].T.astype(np.float64)
    other = frames[which + 1] if which + 1 < len(frames) else frames[which - 1]
    apart_s = other.time_s - frame.time_s
    heading, its = (np.arctan2(p[1, 0], p[0, 0]) for p in (pose, other.world_from_sensor))
    later_s = frame.offset_ns[index] / NS_PER_S
    turned = (np.mod(its - heading + np.pi, 2 * np.pi) - np.pi) / apart_s * later_s
    cos, sin = np.cos(turned), np.sin(turned)
    x, y, z = world.T
    gone = (other.world_from_sensor[:3, 3] - pose[:3, 3]) / apart_s * later_s[:, None]
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1) + pose[:3, 3] + gone
