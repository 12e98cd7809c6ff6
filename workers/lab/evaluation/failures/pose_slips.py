"""Odometry slips: pose errors that no log can contain, injected into poses during mining."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.arrays import Transform
from schemas.frame import LidarFrame, PosedFrame
from workers.parts.protocols import Odometry
from workers.points.se3 import inverse


@dataclass(frozen=True, slots=True)
class Slip:
    """An interval in which every step between two frames has the same error.

    Attributes:
        start_ns: First instant, nanoseconds since the Unix epoch.
        end_ns: First instant after it.
        yaw_rad: Yaw error of each step, radians.
        ahead_m: Forward error of each step, metres.
    """

    start_ns: int
    end_ns: int
    yaw_rad: float
    ahead_m: float


class SlippingOdometry:
    """An odometry whose steps slip; the error stays in all later poses, as in real odometry.

    Its poses carry the quality of the odometry underneath: detecting a slip is left to other parts.
    """

    def __init__(self, inner: Odometry, slips: Sequence[Slip]) -> None:
        self._inner, self._slips = inner, tuple(slips)

    @property
    def version(self) -> str:
        """Version of the odometry underneath, followed by the slips."""
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
