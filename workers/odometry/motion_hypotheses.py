"""How the sensor moves, where a few frames allow several motions: tried, doubted, asked again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from workers.lidar.deskew import Twist
from workers.odometry.registration_pass import Run
from workers.odometry.velocity_initialisation import contradicted_share, likely_velocities
from workers.points.se3 import inverse

BEGINNING_S: Final = 0.35
"""So much is looked at before it is said how the sensor moves: five frames at 10 Hz."""

FEWEST_HELD: Final = 3
_ANOTHER_M: Final = 0.5
"""Poses that differ by less are the same registration, or lead to it."""

_BETTER: Final = 0.95
"""What free space must contradict less, at most. On simulated motorways on which the odometry began
by standing still it was .58 to .87."""

_ALIKE: Final = 1.25
"""What free space contradicts no more than by this factor may be the truth as well: on a motorway
full of cars that drive along standing still was contradicted .12, the true speed .14, and a second
later .11 and .09."""

_AGAIN_S: Final = 1.0

_LOOKS: Final = 5
"""So often; what is not clear by then, as among cars that drive along all around, is believed."""

_CONFIRMED: Final = 2
"""Looks that must bear out a motion that was not believed before. On one motorway a single look
said that the car stands, contradicted .12 for .16, the ones before and after that it drives."""


@dataclass(frozen=True, slots=True, eq=False)
class Likeliest:
    """How the sensor moves, as far as a few frames tell.

    Attributes:
        run: The run that goes on from there.
        posed: The frames as it poses them.
        alike: What else may be, in words; empty where it is clear.
    """

    run: Run
    posed: list[PosedFrame]
    alike: str = ""


def likeliest(run: Run, posed: list[PosedFrame], begin: Callable[[Twist], Run]) -> Likeliest:
    """Try every motion that two frames allow beside the one that is believed.

    Args:
        run: The run that posed the frames.
        posed: Frames in a row.
        begin: Begins another run before the first of them, with a motion per second.
    """
    frames = [each.frame for each in posed]
    dt_s, first_m, gone_m = span_s(frames[:2]), moved_m(posed[:2]), moved_m(posed)
    ways = [(float("nan"), run, posed)]
    for velocity in likely_velocities(frames[0], frames[1]):
        if np.linalg.norm(velocity[3:] * dt_s - first_m) < _ANOTHER_M:
            continue
        other = begin(velocity)
        posed_so = [other.pose(frame) for frame in frames]
        if np.linalg.norm(moved_m(posed_so) - gone_m) < _ANOTHER_M:
            continue
        if len(ways) == 1:
            ways[0] = (contradicted_share(posed), run, posed)
        ways.append((contradicted_share(posed_so), other, posed_so))
    best = ways[0]
    for way in ways[1:]:
        if way[0] < _BETTER * best[0]:
            best = way
    gone_m = moved_m(best[2])
    for share_so, _, posed_so in ways:
        apart = float(np.linalg.norm(moved_m(posed_so) - gone_m)) >= _ANOTHER_M
        if apart and share_so <= _ALIKE * best[0]:
            return Likeliest(best[1], best[2], f"{_speed(posed_so):.0f} m/s would fit alike")
    return Likeliest(best[1], best[2])


class Unsure:
    """A stretch of which it is not clear yet how the sensor moves: it is looked at each second."""

    def __init__(self, found: Likeliest, *, looks: int = _LOOKS, owed: int = 0) -> None:
        """Begin after its first frames.

        Args:
            found: How the sensor seems to move, and what else may be.
            looks: How often it is looked at again.
            owed: Of these, how many must bear it out even where nothing else fits.
        """
        self._posed = list(found.posed)
        self._looks = looks
        self._owed = owed
        self._asked_ns = found.posed[-1].frame.stamp_ns
        self._alike = found.alike

    def look_again(self, run: Run, now: PosedFrame) -> tuple[Run, PosedFrame, "Unsure | None"]:
        """Doubt a pose, or once a second say how the sensor moves.

        Args:
            run: That posed it.
            now: The frame.

        Returns:
            The run that goes on, the frame as it is posed, and whether that is still not clear.
        """
        self._posed.append(now)
        since_s = (now.frame.stamp_ns - self._asked_ns) / NS_PER_S
        if since_s < _AGAIN_S:
            return run, doubted(now, self._alike), self
        last = [
            each
            for each in self._posed
            if now.frame.stamp_ns - each.frame.stamp_ns <= (BEGINNING_S + 0.1) * NS_PER_S
        ]
        if len(last) < FEWEST_HELD:
            return run, now, None
        begins = last[0].odom_from_sensor
        found = likeliest(run, last, lambda velocity: Run(begins, velocity))
        if found.run is not run:
            reason = f"the sensor moves at {_speed(found.posed):.0f} m/s, other than was believed"
            now = replace(found.posed[-1], odometry=OdometryState.LOST, reason=reason, jumped=True)
            found = replace(found, posed=[*found.posed[:-1], now])
            alike = found.alike or f"{_speed(last):.0f} m/s was believed before"
            looks = max(self._looks - 1, _CONFIRMED)
            unsure = Unsure(replace(found, alike=alike), looks=looks, owed=_CONFIRMED)
            return found.run, now, unsure
        if self._looks <= 1 or not (found.alike or self._owed > 1):
            return found.run, now, None
        alike = found.alike or self._alike
        unsure = Unsure(replace(found, alike=alike), looks=self._looks - 1, owed=self._owed - 1)
        return found.run, doubted(now, alike), unsure


def doubted(posed: PosedFrame, alike: str) -> PosedFrame:
    """The same pose, doubted where nothing worse is known of it."""
    if posed.odometry is not OdometryState.HEALTHY:
        return posed
    return replace(posed, odometry=OdometryState.DEGRADED, reason=alike)


def span_s(frames: Sequence[LidarFrame]) -> float:
    """Seconds from the first frame to the last."""
    return (frames[-1].stamp_ns - frames[0].stamp_ns) / NS_PER_S


def _speed(posed: Sequence[PosedFrame]) -> float:
    return float(np.linalg.norm(moved_m(posed))) / span_s([each.frame for each in posed])


def moved_m(posed: Sequence[PosedFrame]) -> NDArray[np.float64]:
    """(3,) where the sensor is in the last frame, in its space of the first."""
    moved: NDArray[np.float64] = (inverse(posed[0].odom_from_sensor) @ posed[-1].odom_from_sensor)[
        :3, 3
    ]
    return moved
