"""Pose doubt: labels made with a wrong pose are doubted for as long as streams remember it."""

from dataclasses import replace
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.contradiction import LabelledFrame
from schemas.frame import OdometryState
from workers.witness.observation import Observation

REMEMBERED_NS: Final = NS_PER_S
"""Time for which a wrong pose has effects: streams compare a frame with those of the last second.
"""


class PoseDoubt:
    """Marks poses that a second registration contradicts, and those of the second after them."""

    def __init__(self) -> None:
        self._since_ns: int | None = None
        self._problem = ""

    def of(self, labelled: LabelledFrame, observation: Observation) -> LabelledFrame:
        """Return the frame, its pose marked as degraded where a second registration differs."""
        if observation.problem:
            self._since_ns, self._problem = observation.stamp_ns, observation.problem
        if observation.remark:
            labelled = replace(labelled, posed=replace(labelled.posed, remark=observation.remark))
        posed = labelled.posed
        if self._since_ns is None or posed.odometry is not OdometryState.HEALTHY:
            return labelled
        if not 0 <= observation.stamp_ns - self._since_ns <= REMEMBERED_NS:
            return labelled
        doubted = replace(
            posed,
            odometry=OdometryState.DEGRADED,
            reason=self._problem,
            jumped=posed.jumped or bool(observation.problem),
        )
        return replace(labelled, posed=doubted)
