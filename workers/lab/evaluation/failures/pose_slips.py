"""Odometry that slips: what no log can hold, put into the poses of the frames as they are mined."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.arrays import Transform
from schemas.frame import LidarFrame, PosedFrame
from workers.parts.protocols import Odometry
from workers.points.se3 import inverse


@dataclass(frozen=True, slots=True)
class Slip:
    """A stretch of time in which every step between two frames is measured wrong.

    Attributes:
        start_ns: First instant, nanoseconds since the Unix epoch.
        end_ns: First instant after it.
        yaw_rad: What each step turns too far.
        ahead_m: What each step goes too far.
    """

    start_ns: int
    end_ns: int
    yaw_rad: float
    ahead_m: float


class SlippingOdometry:
    """An odometry whose steps slip; what was slipped is never found again, as in a real one.

    Its poses still call themselves as the odometry underneath does: to notice is others' work.
    """

    def __init__(self, inner: Odometry, slips: Sequence[Slip]) -> None:
        self._inner, self._slips = inner, tuple(slips)

    @property
    def version(self) -> str:
        """That of the odometry underneath, and the slips."""
        return f"{self._inner.version} slipping {self._slips}"

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        """Yield each frame with its pose, in order."""
        true: Transform | None = None
        wrong: Transform = np.eye(4)
        for posed in self._inner(frames):
            pose = posed.odom_from_sensor
            wrong = pose if true is None else wrong @ (inverse(true) @ pose)
            slips = [s for s in self._slips if s.start_ns <= posed.frame.stamp_ns < s.end_ns]
            for slip in slips if true is not None else ():
                wrong = wrong @ _step(slip)
            true = pose
            yield replace(posed, odom_from_sensor=np.ascontiguousarray(wrong))


def _step(slip: Slip) -> Transform:
    cos, sin = np.cos(slip.yaw_rad), np.sin(slip.yaw_rad)
    step = np.eye(4)
    step[:2, :2] = [[cos, -sin], [sin, cos]]
    step[0, 3] = slip.ahead_m
    return step
