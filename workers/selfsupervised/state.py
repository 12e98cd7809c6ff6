"""State of the default self-supervised stream in one pass over the frames of a shard."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask, Points, Transform
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.labels import Blindness, FrameHealth, FrameLabels
from workers.free_space import HIDDEN, count_votes, visibility, with_views
from workers.lidar.deskew import Twist, twist
from workers.lidar.preprocessing import Preprocessor
from workers.points.neighbours import build_grid
from workers.points.se3 import inverse
from workers.selfsupervised.bent_sweeps import BentSweeps
from workers.selfsupervised.evidence import FreeSpaceEvidence
from workers.selfsupervised.history import (
    FAR_AGE_S,
    MAX_GAP_NS,
    NEAR_AGE_S,
    History,
    PastFrame,
    voters,
)
from workers.selfsupervised.labelling import to_labels, unknown_labels
from workers.selfsupervised.lookahead_buffer import BufferedFrame, ComparableFrame
from workers.selfsupervised.motion import find_motions
from workers.selfsupervised.moving_bodies import complete_bodies
from workers.selfsupervised.occlusion_fragments import merge_fragments
from workers.selfsupervised.pose_consistency import PoseConsistency
from workers.selfsupervised.pose_continuity import PoseContinuity, fits
from workers.selfsupervised.registration import Reference, reference_to
from workers.selfsupervised.single_voxels import assign_single_voxels
from workers.selfsupervised.tracker import Tracker

_NEAR_AGES_S: Final = (0.04, 0.45)
_FAR_AGES_S: Final = (0.38, 0.75)
"""Ages of the far reference, seconds; at 5 Hz the closest is 0.4 s old."""


class StreamState:
    """State of one pass over the frames of a shard.

    Within one second of the clock all poses and places are in the space of its first frame. Voxels
    are then the same wherever a log was cut, if the poses are. The modules called from here receive
    that space as odom space.
    """

    def __init__(self, *, looks_ahead: bool = False) -> None:
        self._prepare = Preprocessor()
        self._history = History()
        self._tracker = Tracker()
        self._consistency = PoseConsistency()
        self._continuity = PoseContinuity() if looks_ahead else None
        self._refused: PastFrame | None = None
        self._disconnected = False
        self._last: PosedFrame | None = None
        self._bent_sweeps = BentSweeps()
        self._first_ns = 0
        self._space: Transform = np.eye(4)
        self._expressed_in = self._space

    def prepare(self, posed: PosedFrame) -> BufferedFrame:
        """Preprocess an arriving frame for comparison."""
        frame = posed.frame
        last_ns = None if self._last is None else self._last.frame.stamp_ns
        restarts = last_ns is not None and not 0 < frame.stamp_ns - last_ns <= MAX_GAP_NS
        if restarts:
            self._last = None
        if restarts or frame.stamp_ns // NS_PER_S != self._first_ns // NS_PER_S:
            self._first_ns, self._space = frame.stamp_ns, posed.odom_from_sensor
        before, local = self._prepare.table, inverse(self._space) @ posed.odom_from_sensor
        velocity = self._velocity(posed)
        if (bent_ns := self._bent_sweeps.found(frame, velocity)) is not None:
            self._history.forget(bent_ns)
        prepared = self._prepare(frame, local, velocity)
        table = self._prepare.table
        restarts |= table is not before
        self._last = posed
        if prepared is None or table is None:
            health = self._prepare.problem(frame)
            return BufferedFrame(frame, unknown_labels(frame, health=health), restarts=restarts)
        if posed.odometry is OdometryState.LOST:
            self._last = None
            health = FrameHealth(Blindness.NO_POSE, f"odometry lost: {posed.reason}")
            return BufferedFrame(
                frame, unknown_labels(frame, prepared, health=health), restarts=True
            )
        places, pose = prepared.voxels.centroids_m, prepared.odom_from_beams
        grid = build_grid(places, pose[:3, 3])
        away, image = prepared.beams_from_odom, prepared.image
        seen = PastFrame(frame.stamp_ns, self._space, pose, away, image, grid, prepared.views)
        if self._continuity is not None:
            self._disconnected = not self._continuity.follows(seen, places, restarts=restarts)
        blind = None if table.trusted else self._prepare.problem(frame)
        ready = ComparableFrame(prepared, seen, table, self._prepare.sensor_height_m, blind)
        return BufferedFrame(frame, ready, restarts=restarts, disconnected=self._disconnected)

    def label(self, waiting: BufferedFrame, later: Sequence[PastFrame]) -> FrameLabels:
        """Label a frame, given earlier frames and the later ones that it waited for.

        A frame that does not fit is left out. If the next frame fits the one left out, the poses
        continued from another place. That next frame is then the first of a new stretch, since the
        jump distorted the sweep of the frame before it.
        """
        if waiting.restarts:
            self._restart()
        if not isinstance(waiting.content, ComparableFrame):
            return waiting.content
        self._express_in(waiting.content.seen.space)
        answer = self._compare(waiting.frame, waiting.content, later)
        seen, refused = waiting.content.seen, self._refused
        match answer.health.blindness:
            case Blindness.NO_FIT:
                places = waiting.content.prepared.voxels.centroids_m
                if refused is None or not fits(self._consistency, seen, places, refused):
                    self._refused = seen
                    return answer
                self._restart()
            case Blindness.NO_PAST if refused is not None:
                self._restart()
        self._refused = None
        if not self._bent_sweeps.was_bent(seen.stamp_ns):
            self._history.add(seen)
        return answer

    def _express_in(self, space: Transform) -> None:
        """Express the remembered frames in another space, given (4, 4) odom from it."""
        if space is not self._expressed_in:
            self._history.express_in(space)
            self._tracker.move(inverse(space) @ self._expressed_in)
            self._expressed_in = space

    def _restart(self) -> None:
        """Forget the frames so far, which cannot be compared with later ones."""
        self._history.clear()
        self._tracker.clear()
        self._refused = None

    def _compare(
        self, frame: LidarFrame, ready: ComparableFrame, later: Sequence[PastFrame]
    ) -> FrameLabels:
        """Compare a frame with those before it, and with those after it."""
        prepared, now_ns, space = ready.prepared, frame.stamp_ns, ready.seen.space
        near = self._history.closest(NEAR_AGE_S, now_ns, between=_NEAR_AGES_S)
        far = self._history.closest(FAR_AGE_S, now_ns, between=_FAR_AGES_S)
        if ready.blind is not None:
            return unknown_labels(frame, prepared, health=ready.blind)
        if near is None or far is None:
            health = FrameHealth(Blindness.NO_PAST, self._no_past(now_ns))
            return unknown_labels(frame, prepared, health=health)

        places, centre_m = prepared.voxels.centroids_m, prepared.odom_from_beams[:3, 3]

        def visible_from(points_m: Points, other: PastFrame) -> NDArray[np.int8]:
            answer = visibility(points_m, other.beams_from(space), other.image, ready.table)
            return with_views(answer, points_m, other.views_from(space))

        def seen_through(points_m: Points) -> Mask:
            before, later = (
                count_votes([visible_from(points_m, each) for each in frames], len(points_m))
                for frames in (asked.values(), afterwards)
            )
            return before.seen_through | later.seen_through

        asked = {past.stamp_ns: past for past in (*self._history.voters(now_ns), near, far)}
        answers = {stamp_ns: visible_from(places, past) for stamp_ns, past in asked.items()}
        references = _reference(near, now_ns), _reference(far, now_ns)
        misfit = self._consistency.problem(
            places,
            centre_m,
            near=(references[0], answers[near.stamp_ns] != HIDDEN),
            far=(references[1], answers[far.stamp_ns] != HIDDEN),
            expected_m=self._history.expected_m(now_ns),
        )
        if misfit:
            health = FrameHealth(Blindness.NO_FIT, misfit)
            return unknown_labels(frame, prepared, health=health)
        votes = count_votes(answers.values(), len(places))
        afterwards = voters(later, now_ns)
        after = count_votes([visible_from(places, each) for each in afterwards], len(places))
        evidence = FreeSpaceEvidence(
            votes=votes,
            after=after,
            near=answers[near.stamp_ns],
            far=answers[far.stamp_ns],
            image=prepared.image,
            table=ready.table,
            sensor_height_m=ready.sensor_height_m,
            beams_from_odom=prepared.beams_from_odom,
            views=prepared.views,
        )
        found = find_motions(places, *references, evidence)
        tracked = self._tracker.update(
            places, found, votes, centre_m=centre_m, now_ns=now_ns, table=ready.table
        )
        tracked = merge_fragments(places, found, tracked, evidence, centre_m=centre_m)
        tracked = complete_bodies(places, found, tracked, references[1], centre_m=centre_m)
        found = assign_single_voxels(places, found, tracked.dynamic, votes, centre_m=centre_m)
        velocity = (tracked.velocity_m_per_s @ space[:3, :3].T).astype(np.float32)
        tracked = replace(tracked, velocity_m_per_s=velocity)
        all_votes = votes + after
        known = all_votes.known
        seen_share = float(known.mean()) if len(known) else float("nan")
        labels = to_labels(frame, prepared, found, tracked, all_votes, seen_through=seen_through)
        return replace(labels, health=FrameHealth(seen_share=seen_share))

    def _velocity(self, posed: PosedFrame) -> Twist | None:
        """Return the twist of the sensor per second; None without two consecutive reliable poses.

        A jump of one pose would also be compensated within the next sweep, and distort its cloud.
        """
        last = self._last
        # with a lookahead frames are labelled later, but continuity is known when they arrive
        doubted = self._disconnected if self._continuity is not None else self._refused is not None
        healthy = posed.odometry is OdometryState.HEALTHY
        if last is None or doubted or not healthy or last.odometry is not OdometryState.HEALTHY:
            return None
        dt_s = (posed.frame.stamp_ns - last.frame.stamp_ns) / NS_PER_S
        return twist(inverse(last.odom_from_sensor) @ posed.odom_from_sensor) / dt_s

    def _no_past(self, now_ns: int) -> str:
        span_s = self._history.span_s(now_ns)
        return f"{span_s:.1f} s of earlier frames, {_FAR_AGES_S[0]} s are needed"


def _reference(past: PastFrame, now_ns: int) -> Reference:
    age_s = (now_ns - past.stamp_ns) / NS_PER_S
    return reference_to(past.grid, past.odom_from_beams[:3, 3], age_s)
