"""The default self-supervised stream: clusters registered over time, verified by free space."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.labels import Blindness, FrameHealth, FrameLabels
from workers.geometry.se3 import inverse
from workers.selfsupervised.answer import nothing_known, to_labels
from workers.selfsupervised.deskew import Twist, twist
from workers.selfsupervised.fit import FitMonitor
from workers.selfsupervised.fragments import fragments_of_movers
from workers.selfsupervised.free_space import HIDDEN, count_votes, visibility
from workers.selfsupervised.history import (
    FAR_AGE_S,
    MAX_GAP_NS,
    NEAR_AGE_S,
    History,
    PastFrame,
)
from workers.selfsupervised.motion import find_motions
from workers.selfsupervised.neighbours import build_grid
from workers.selfsupervised.prepare import Preparation, Prepared
from workers.selfsupervised.registration import Reference, reference_to
from workers.selfsupervised.tracker import Tracker
from workers.selfsupervised.verification import Evidence
from workers.selfsupervised.versions import version_of

_NEAR_AGES_S: Final = (0.04, 0.45)
_FAR_AGES_S: Final = (0.38, 0.75)
"""From 0.38 s on: at 5 Hz the closest is 0.4 s old."""

_MISFITS: Final = 2
"""A frame that does not fit is left out; after two in a row, those before them are forgotten."""


class Registration:
    """Motion without labels or learned weights, from past frames only.

    Each cluster of points off the ground is registered to the frames 0.1 s and 0.5 s ago; a motion
    counts only if free space confirms it: its place was seen through before, or the place that it
    left is seen through now. Free space alone may decide too, from the votes of the last second.
    Nothing is known, and said, in the first half second, after a gap, and where the pose is lost.
    """

    class_names: tuple[str, ...] = ()

    @property
    def version(self) -> str:
        """`registration@digest` of code and libraries."""
        return version_of("registration")

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, at once: no frame waits for a later one."""
        run = _Run()
        for posed in frames:
            yield run.label(posed)


class _Run:
    """State of one pass over the frames of a shard."""

    def __init__(self) -> None:
        self._prepare = Preparation()
        self._history = History()
        self._tracker = Tracker()
        self._fit = FitMonitor()
        self._misfits = 0
        self._last: PosedFrame | None = None

    def label(self, posed: PosedFrame) -> FrameLabels:
        """Label one frame."""
        frame, now_ns = posed.frame, posed.frame.stamp_ns
        if self._last is not None and not 0 < now_ns - self._last.frame.stamp_ns <= MAX_GAP_NS:
            self._forget()
        table = self._prepare.table
        prepared = self._prepare(frame, posed.odom_from_sensor, self._velocity(posed))
        if self._prepare.table is not table:
            self._forget()
        self._last = posed
        if prepared is None:
            return nothing_known(frame, health=self._prepare.problem(frame))
        if posed.odometry is OdometryState.LOST:
            self._forget()
            health = FrameHealth(Blindness.NO_POSE, f"odometry lost: {posed.reason}")
            return nothing_known(frame, prepared, health=health)

        answer = self._compare(frame, prepared)
        if answer.health.blindness is Blindness.NO_FIT:
            self._misfits += 1
            if self._misfits < _MISFITS:
                return answer
            self._forget()
            self._last = posed
        self._misfits = 0
        self._history.add(
            PastFrame(
                now_ns,
                prepared.odom_from_beams,
                prepared.beams_from_odom,
                prepared.image,
                build_grid(prepared.voxels.centroids_m, prepared.odom_from_beams[:3, 3]),
            )
        )
        return answer

    def _compare(self, frame: LidarFrame, prepared: Prepared) -> FrameLabels:
        """Compare a frame with those before it."""
        now_ns, table = frame.stamp_ns, self._prepare.table
        near = self._history.closest(NEAR_AGE_S, now_ns, between=_NEAR_AGES_S)
        far = self._history.closest(FAR_AGE_S, now_ns, between=_FAR_AGES_S)
        if table is None or not table.trusted:
            return nothing_known(frame, prepared, health=self._prepare.problem(frame))
        if near is None or far is None:
            health = FrameHealth(Blindness.NO_PAST, self._no_past(now_ns))
            return nothing_known(frame, prepared, health=health)

        places, centre_m = prepared.voxels.centroids_m, prepared.odom_from_beams[:3, 3]
        asked = {past.stamp_ns: past for past in (*self._history.voters(now_ns), near, far)}
        answers = {
            stamp_ns: visibility(places, past.beams_from_odom, past.image, table)
            for stamp_ns, past in asked.items()
        }
        references = _reference(near, now_ns), _reference(far, now_ns)
        misfit = self._fit.problem(
            places,
            centre_m,
            near=(references[0], answers[near.stamp_ns] != HIDDEN),
            far=(references[1], answers[far.stamp_ns] != HIDDEN),
        )
        if misfit:
            health = FrameHealth(Blindness.NO_FIT, misfit)
            return nothing_known(frame, prepared, health=health)
        votes = count_votes(answers.values(), len(places))
        evidence = Evidence(
            votes=votes,
            near=answers[near.stamp_ns],
            far=answers[far.stamp_ns],
            image=prepared.image,
            table=table,
            sensor_height_m=self._prepare.sensor_height_m,
            beams_from_odom=prepared.beams_from_odom,
        )
        found = find_motions(places, *references, evidence)
        tracked = self._tracker.update(places, found, votes, centre_m=centre_m, now_ns=now_ns)
        tracked = fragments_of_movers(places, found, tracked, votes, centre_m=centre_m)
        known = votes.known
        seen_share = float(known.mean()) if len(known) else float("nan")
        labels = to_labels(frame, prepared, found, tracked, votes)
        return replace(labels, health=FrameHealth(seen_share=seen_share))

    def _velocity(self, posed: PosedFrame) -> Twist | None:
        """Twist of the sensor per second; None where two poses in a row cannot be believed.

        A jump of one pose would be undone within the next sweep as well, and bend its cloud.
        """
        last = self._last
        healthy = posed.odometry is OdometryState.HEALTHY
        if (
            last is None
            or self._misfits
            or not healthy
            or last.odometry is not OdometryState.HEALTHY
        ):
            return None
        dt_s = (posed.frame.stamp_ns - last.frame.stamp_ns) / NS_PER_S
        return twist(inverse(last.odom_from_sensor) @ posed.odom_from_sensor) / dt_s

    def _no_past(self, now_ns: int) -> str:
        span_s = self._history.span_s(now_ns)
        return f"{span_s:.1f} s of earlier frames, {_FAR_AGES_S[0]} s are needed"

    def _forget(self) -> None:
        """Begin anew: what was before cannot be compared with what comes."""
        self._history.clear()
        self._tracker.clear()
        self._last = None


def _reference(past: PastFrame, now_ns: int) -> Reference:
    age_s = (now_ns - past.stamp_ns) / NS_PER_S
    return reference_to(past.grid, past.odom_from_beams[:3, 3], age_s)
