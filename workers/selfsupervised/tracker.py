"""Tracker: evidence of motion is carried along with the points of moving clusters.

One frame may show a mover in pieces, half hidden, or too flat to be verified; earlier frames have
the evidence. The points of moving clusters are carried on by their velocity, and a cluster that
most of them hit inherits their score.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask, Points, Transform
from workers.free_space import Votes
from workers.lidar.beam_table import BeamTable
from workers.points.neighbours import build_grid, nearest_indices
from workers.points.se3 import transform
from workers.points.step_names import step
from workers.selfsupervised.candidates import same_velocity
from workers.selfsupervised.confirmation_weight import confirms_in_full
from workers.selfsupervised.motion import ClusterMotions
from workers.selfsupervised.registration import MAX_EXTENT_M

DYNAMIC_SCORE: Final = 0.6
"""Score from which a cluster is dynamic; one frame in full gives 1, and 0.7 a tenth of a second
later."""

KEPT_PER_S: Final = 0.7**10
"""Share of a score left after a second without evidence: 30 % are lost in a tenth."""

CONFIRMED_SCORE: Final = 1.15
"""Score from which a motion is confirmed: a full and a half confirmation in consecutive frames, a
little late (0.7 + 0.5). One frame gives at most 1."""

CONFIRMED_VOXELS: Final = 150
"""Voxels from which one frame confirms a motion; free space was never wrong about so many at once.
"""

CARRIED_SCORE: Final = 0.2
MIN_SCORE, MAX_SCORE = -1.0, 2.0
"""Bounds of a score: two frames' worth, so that a long motion can be refuted as fast as a short
one."""

REACH_M: Final = 0.5
"""Distance between a carried point and its object, metres: a velocity error of 5 m/s."""

MIN_HIT_SHARE: Final = 0.3
MOST_GROWTH: Final = 2.0
"""Growth up to which a cluster inherits a score: evidence on a fragment is not valid for an object
more than twice its size."""

_FULL: Final = 1.0
_HALF: Final = 0.5
_HINT: Final = 0.2
_STATIC: Final = -0.7
_OCCUPIED_BEFORE: Final = -0.2
_STATIC_FREE_SHARE: Final = 0.2
_STATIC_VOTES: Final = 2.0
_OCCUPIED_BEFORE_VOTES: Final = 4.0
_NEW_WEIGHT: Final = np.float32(0.6)
"""Weight of a new velocity; the rest is the carried one: a memory of two measurements."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """Motions of K clusters after the evidence of earlier frames.

    Attributes:
        dynamic: (K,) clusters that move by all evidence together.
        confirmed: (K,) those that two frames, or very many voxels, confirm.
        velocity_m_per_s: (K, 3) over the ground, odom space; zero where nothing is known.
    """

    dynamic: Mask
    confirmed: Mask
    velocity_m_per_s: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class _Inherited:
    known: Mask
    score: NDArray[np.float32]
    velocity: NDArray[np.float32]


class Tracker:
    """Carries the points of moving clusters from frame to frame."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget everything, after a gap or when the pose is lost."""
        self._points_m: Points = np.zeros((0, 3), np.float32)
        self._velocity = np.zeros((0, 3), np.float32)
        self._score = np.zeros(0, np.float32)
        self._stamp_ns = 0

    def move(self, to_from_from: Transform) -> None:
        """Express the carried points in another space, given (4, 4) from their present one."""
        self._points_m = transform(to_from_from, self._points_m)
        self._velocity = (self._velocity @ to_from_from[:3, :3].T).astype(np.float32)

    @step("tracker")
    def update(
        self,
        points_m: Points,
        found: ClusterMotions,
        votes: Votes,
        *,
        centre_m: NDArray[np.floating],
        now_ns: int,
        table: BeamTable,
    ) -> Tracked:
        """Add the evidence of a frame to the carried evidence.

        Args:
            points_m: (V, 3) voxel centroids off the ground, odom space.
            found: Their clusters and motions.
            votes: Free-space votes on the voxels.
            centre_m: (3,) the sensor, odom space.
            now_ns: Time of the frame.
            table: Beams of the sensor, which determine how many voxels an object can show.
        """
        clusters = found.clusters
        dt_s = (now_ns - self._stamp_ns) / NS_PER_S
        before = self._inherited(points_m, found, centre_m, np.float32(dt_s))
        kept = before.score * np.float32(KEPT_PER_S**dt_s)
        in_full = confirms_in_full(points_m, clusters, votes, centre_m=centre_m, table=table)
        summed = kept + _evidence(found, votes, before, in_full)
        score = np.clip(summed, MIN_SCORE, MAX_SCORE).astype(np.float32)

        measured = found.velocity_m_per_s
        weight = np.where(found.registered, np.where(before.known, _NEW_WEIGHT, 1), 0)[:, None]
        velocity = (weight * measured + (1 - weight) * before.velocity).astype(np.float32)

        carried = np.flatnonzero(clusters.member_mask(score > CARRIED_SCORE))
        owner = clusters.of_point[carried]
        self._points_m, self._stamp_ns = points_m[carried], now_ns
        self._velocity, self._score = velocity[owner], score[owner]
        dynamic = score >= DYNAMIC_SCORE
        many = clusters.sizes >= CONFIRMED_VOXELS
        return Tracked(dynamic, dynamic & (many | (score >= CONFIRMED_SCORE)), velocity)

    def _inherited(
        self,
        points_m: Points,
        found: ClusterMotions,
        centre_m: NDArray[np.floating],
        dt_s: np.float32,
    ) -> _Inherited:
        """Average score and velocity of the carried points that land on each cluster."""
        clusters, k = found.clusters, len(found.clusters)
        if k == 0 or len(self._points_m) == 0:
            nothing = np.zeros(k, np.float32)
            return _Inherited(np.zeros(k, np.bool_), nothing, np.zeros((k, 3), np.float32))
        grid = build_grid(self._points_m + self._velocity * dt_s, centre_m)
        nearest = nearest_indices(grid, points_m[clusters.members], REACH_M)
        hit = nearest >= 0
        source = grid.order[nearest[hit]]
        owner = np.repeat(np.arange(k), clusters.sizes)[hit]
        hits = np.bincount(owner, minlength=k)
        pairs = np.unique(owner.astype(np.int64) << 32 | source)
        carried = np.bincount(pairs >> 32, minlength=k)
        known = (hits > MIN_HIT_SHARE * clusters.sizes) & (clusters.sizes <= MOST_GROWTH * carried)

        def mean(values: NDArray[np.float32]) -> NDArray[np.float32]:
            total = np.bincount(owner, values[source], minlength=k)
            return np.where(known, total / np.maximum(hits, 1), 0).astype(np.float32)

        velocity = np.stack([mean(self._velocity[:, axis]) for axis in range(3)], axis=1)
        return _Inherited(known, mean(self._score), velocity)


def _evidence(
    found: ClusterMotions, votes: Votes, before: _Inherited, in_full: Mask
) -> NDArray[np.float64]:
    """Return (K,) evidence of this frame alone, above zero for motion and below it against."""
    clusters = found.clusters
    size = np.maximum(clusters.sizes, 1)
    seen = clusters.mean(votes.occupied)
    free_share = clusters.count(votes.seen_through) / size
    as_before = found.unconfirmed & same_velocity(found.velocity_m_per_s, before.velocity)
    near_moves = found.near_velocity_m_per_s.any(axis=1) & ~found.still
    as_before |= near_moves & same_velocity(found.near_velocity_m_per_s, before.velocity)
    hint = before.known & as_before & (found.extent_m <= MAX_EXTENT_M)
    static = found.still & (free_share < _STATIC_FREE_SHARE) & (seen > _STATIC_VOTES)
    occupied_before = ~found.unconfirmed & (seen > _OCCUPIED_BEFORE_VOTES)
    return np.select(
        [found.dynamic_now & in_full, found.dynamic_now, hint, static, occupied_before],
        [_FULL, _HALF, _HINT, _STATIC, _OCCUPIED_BEFORE],
        default=0.0,
    )
