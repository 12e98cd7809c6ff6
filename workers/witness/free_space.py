"""The third witness: a place seen through within a second before or after is not static."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask, Points
from schemas.contradiction import LabelledFrame
from schemas.labels import FrameHealth, FrameLabels, MotionLabel
from workers.free_space import visibility, with_views
from workers.points.clusters import Clusters, connected
from workers.sources import syntax_digest
from workers.witness.free_space_votes import FreeSpaceVotes, votes_of
from workers.witness.observation import Observation, Observer
from workers.witness.pose_doubt import PoseDoubt

REACH_S: Final = 1.0
AGES_S: Final = (1.0, 0.8, 0.6, 0.4, 0.2)
"""Ages of the voting frames, seconds, farthest first; frames in between agree with these."""

MAX_VOTES: Final = 2 * len(AGES_S)
"""Number of frames that vote on a place at most: those of a full second before and after."""

_TOLERANCE_NS: Final = NS_PER_S // 16
"""Half a revolution at 10 Hz and its jitter."""

MAX_FRAMES: Final = 64
"""Frames kept at most, at any sensor rate: two seconds at 30 Hz."""


class TwoSidedFreeSpace:
    """Free space from a second before to a second after, a future that no live stream has seen.

    Frames are held back until those a second later have arrived, or until the shard ends; later
    frames are unknown. No frame votes across a gap, a lost pose or a pose jump.
    """

    @property
    def version(self) -> str:
        """`free-space@digest` of code."""
        return f"free-space@{syntax_digest('workers.witness')[:12]}"

    def __call__(self, frames: Iterable[LabelledFrame]) -> Iterator[LabelledFrame]:
        """Yield each frame with the witness's labels, in order, a second later."""
        observe, pose_doubt = Observer(), PoseDoubt()
        past: deque[Observation] = deque(maxlen=MAX_FRAMES)
        waiting: deque[tuple[LabelledFrame, Observation]] = deque()
        for labelled, following in _with_following(frames):
            newest = observe(labelled, following)
            waiting.append((pose_doubt.of(labelled, newest), newest))
            while _has_waited(waiting[0][1], newest) or len(waiting) > MAX_FRAMES:
                yield _next(past, waiting)
        while waiting:
            yield _next(past, waiting)


def _with_following(
    frames: Iterable[LabelledFrame],
) -> Iterator[tuple[LabelledFrame, LabelledFrame | None]]:
    """Yield each frame with the one after it, None after the last one."""
    before: LabelledFrame | None = None
    for labelled in frames:
        if before is not None:
            yield before, labelled
        before = labelled
    if before is not None:
        yield before, None


def _has_waited(first: Observation, newest: Observation) -> bool:
    long = newest.stamp_ns - first.stamp_ns >= round(REACH_S * NS_PER_S) - _TOLERANCE_NS // 4
    return long or first.stretch != newest.stretch


def _next(
    past: deque[Observation], waiting: deque[tuple[LabelledFrame, Observation]]
) -> LabelledFrame:
    labelled, observation = waiting.popleft()
    classified = classify(labelled, observation, before=past, after=[later for _, later in waiting])
    past.append(observation)
    horizon_ns = observation.stamp_ns - round(REACH_S * NS_PER_S) - _TOLERANCE_NS
    while past[0].stamp_ns < horizon_ns or past[0].stretch != observation.stretch:
        past.popleft()
    return replace(labelled, witness=classified)


def classify(
    labelled: LabelledFrame,
    observation: Observation,
    *,
    before: Iterable[Observation],
    after: Iterable[Observation],
) -> FrameLabels:
    """Label the points of a frame by the votes of other frames on their places.

    Args:
        labelled: The frame.
        observation: Observation of the frame.
        before: Earlier ones.
        after: Later ones.

    Returns:
        DYNAMIC, STATIC or UNKNOWN for every point; the confidence is the number of frames that vote
        on it, as a share of `MAX_VOTES`. At either end of a log it is at most one half.
    """
    n = len(labelled.posed.frame)
    labels = np.full(n, MotionLabel.UNKNOWN, np.uint8)
    confidence = np.zeros(n, np.float16)
    view = observation.view
    if view is None:
        return FrameLabels(labels, confidence)
    centroids = view.places.centroids_m
    sides = [_visibilities(observation, centroids, others) for others in (before, after)]
    votes = [votes_of(answers, len(centroids)) for answers in sides]
    seen_through = votes[0].seen_through | votes[1].seen_through
    free, occupied = _sums(votes)
    moves = _moving(centroids, seen_through, free + occupied > 0)
    classified = np.full(len(centroids), MotionLabel.UNKNOWN, np.uint8)
    classified[(occupied > free) & ~seen_through] = MotionLabel.STATIC
    classified[moves] = MotionLabel.DYNAMIC
    known = (free + occupied) / MAX_VOTES
    sure = np.where(classified == MotionLabel.UNKNOWN, 0.0, known)
    of_point = view.places.of_point
    labels[view.judged_index] = classified[of_point]
    confidence[view.judged_index] = sure.astype(np.float16)[of_point]
    seen_share = float(np.mean(known > 0)) if len(known) else float("nan")
    return FrameLabels(labels, confidence, health=FrameHealth(seen_share=seen_share))


def _sums(votes: Sequence[FreeSpaceVotes]) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    return votes[0].free + votes[1].free, votes[0].occupied + votes[1].occupied


def _visibilities(
    observation: Observation, places_m: Points, others: Iterable[Observation]
) -> list[NDArray[np.int8]]:
    """Return the visibility of a frame's places from the frames of one side, farthest first."""
    able = {
        abs(other.stamp_ns - observation.stamp_ns): other.view
        for other in others
        if other.stretch == observation.stretch and other.view is not None
    }
    answers = []
    for age_s in AGES_S:
        age_ns = round(age_s * NS_PER_S)
        away_ns = min(able, key=lambda each: (abs(each - age_ns), each), default=None)
        if away_ns is None or abs(away_ns - age_ns) > _TOLERANCE_NS:
            continue
        view = able.pop(away_ns)
        answer = visibility(places_m, view.beams_from_odom, view.image, view.table)
        answers.append(with_views(answer, places_m, view.further))
    return answers


OBJECT_REACH_M: Final = 0.5
FINDING_REACH_M: Final = 0.6
MIN_FINDING: Final = 5
MIN_OBJECT_SHARE: Final = 0.3
MIXED_SHARE: Final = 0.6
"""Share of free places below which a moving object may contain a standing one."""

CLOSE_REACH_M: Final = 0.3
MIN_STANDING: Final = 20
MAX_MOVING_SHARE: Final = 0.1
"""Reach, metres, that separates a mover from a parked car next to it; least places of a part that
stands, and the share of its places below which it does."""

FLAT_M: Final = 0.3
"""Height below which a finding is a strip of road, which moves with the car, or a kerb, metres."""


def _heights_m(places_m: Points, clusters: Clusters) -> NDArray[np.float32]:
    height = places_m[clusters.members, 2]
    begin = clusters.start[:-1]
    if len(begin) == 0:
        return np.zeros(0, np.float32)
    return np.maximum.reduceat(height, begin) - np.minimum.reduceat(height, begin)


def _moving(places_m: NDArray[np.float32], seen_through: Mask, known: Mask) -> Mask:
    """Return the places of objects with enough connected free places, as a share of the object."""
    found = connected(places_m, reach_m=FINDING_REACH_M, min_points=MIN_FINDING, among=seen_through)
    moves = found.member_mask(_heights_m(places_m, found) >= FLAT_M)
    objects = connected(places_m, reach_m=OBJECT_REACH_M, min_points=MIN_FINDING)
    share = objects.count(moves) / np.maximum(objects.count(known), 1)
    whole = (objects.count(moves) >= MIN_FINDING) & (share >= MIN_OBJECT_SHARE)
    mixed = objects.member_mask(whole & (share < MIXED_SHARE))
    stands = _standing_parts(places_m, objects, moves, among=mixed)
    return moves | (objects.member_mask(whole) & ~stands)


def _standing_parts(
    places_m: NDArray[np.float32], objects: Clusters, moves: Mask, *, among: Mask
) -> Mask:
    """Return the places of whole parts of mixed objects in which next to nothing moves.

    A mover that passes a parked car within half a metre forms one object with it.
    """
    parts = connected(
        places_m,
        reach_m=CLOSE_REACH_M,
        min_points=MIN_STANDING,
        among=among,
        groups=objects.of_point,
    )
    return parts.member_mask(parts.count(moves) < MAX_MOVING_SHARE * parts.sizes)
