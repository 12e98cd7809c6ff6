"""The default self-supervised stream: clusters registered over time, verified by free space."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.labels import FrameLabels
from workers.geometry.se3 import inverse
from workers.selfsupervised.answer import nothing_known, to_labels
from workers.selfsupervised.deskew import Twist, twist
from workers.selfsupervised.fragments import fragments_of_movers
from workers.selfsupervised.free_space import count_votes, visibility
from workers.selfsupervised.history import (
    FAR_AGE_S,
    MAX_GAP_NS,
    NEAR_AGE_S,
    History,
    PastFrame,
)
from workers.selfsupervised.motion import find_motions
from workers.selfsupervised.prepare import Preparation, Prepared
from workers.selfsupervised.registration import Reference, build_reference
from workers.selfsupervised.tracker import Tracker
from workers.selfsupervised.verification import Evidence
from workers.selfsupervised.versions import version_of

_NEAR_AGES_S: Final = (0.04, 0.45)
_FAR_AGES_S: Final = (0.38, 0.75)
"""From 0.38 s on: at 5 Hz the closest is 0.4 s old."""


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
        self._last: PosedFrame | None = None

    def label(self, posed: PosedFrame) -> FrameLabels:
        """Label one frame."""
        frame, now_ns = posed.frame, posed.frame.stamp_ns
        if self._last is not None and not 0 < now_ns - self._last.frame.stamp_ns <= MAX_GAP_NS:
            self._forget()
        prepared = self._prepare(frame, posed.odom_from_sensor, self._velocity(posed))
        self._last = posed
        if prepared is None:
            return nothing_known(frame)
        if posed.odometry is OdometryState.LOST:
            self._forget()
            return nothing_known(frame, prepared)

        answer = self._compare(frame, prepared)
        self._history.add(
            PastFrame(
                now_ns,
                prepared.odom_from_beams,
                prepared.beams_from_odom,
                prepared.image,
                prepared.voxels.centroids_m,
            )
        )
        return answer

    def _compare(self, frame: LidarFrame, prepared: Prepared) -> FrameLabels:
        """Compare a frame with those before it."""
        now_ns, table = frame.stamp_ns, self._prepare.table
        near = self._history.closest(NEAR_AGE_S, now_ns, between=_NEAR_AGES_S)
        far = self._history.closest(FAR_AGE_S, now_ns, between=_FAR_AGES_S)
        if table is None or not table.trusted or near is None or far is None:
            return nothing_known(frame, prepared)

        places = prepared.voxels.centroids_m
        asked = {past.stamp_ns: past for past in (*self._history.voters(now_ns), near, far)}
        answers = {
            stamp_ns: visibility(places, past.beams_from_odom, past.image, table)
            for stamp_ns, past in asked.items()
        }
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
        found = find_motions(places, _reference(near, now_ns), _reference(far, now_ns), evidence)
        centre_m = prepared.odom_from_beams[:3, 3]
        tracked = self._tracker.update(places, found, votes, centre_m=centre_m, now_ns=now_ns)
        merged = fragments_of_movers(places, found, tracked.dynamic, votes, centre_m=centre_m)
        tracked = replace(tracked, dynamic=tracked.dynamic | merged)
        return to_labels(frame, prepared, found, tracked, votes)

    def _velocity(self, posed: PosedFrame) -> Twist | None:
        """Twist of the sensor per second; None where two poses in a row cannot be believed."""
        last = self._last
        healthy = posed.odometry is OdometryState.HEALTHY
        if last is None or not healthy or last.odometry is not OdometryState.HEALTHY:
            return None
        dt_s = (posed.frame.stamp_ns - last.frame.stamp_ns) / NS_PER_S
        return twist(inverse(last.odom_from_sensor) @ posed.odom_from_sensor) / dt_s

    def _forget(self) -> None:
        """Begin anew: what was before cannot be compared with what comes."""
        self._history.clear()
        self._tracker.clear()
        self._last = None


def _reference(past: PastFrame, now_ns: int) -> Reference:
    age_s = (now_ns - past.stamp_ns) / NS_PER_S
    return build_reference(past.centroids_m, past.odom_from_beams[:3, 3], age_s)
