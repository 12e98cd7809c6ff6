"""Where the sensor was at each frame, and whether that may be believed: KISS-ICP under guard."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from workers.odometry.motion_hypotheses import (
    BEGINNING_S,
    FEWEST_HELD,
    Unsure,
    doubted,
    likeliest,
    span_s,
)
from workers.odometry.registration_pass import MAX_GAP_S, RESIDUAL_REACH_M, Run
from workers.part_version import version_of

_MOST_HELD: Final = 10
_ASTRAY_S: Final = 0.5
"""So long no car can go or turn as it is said to, or nothing fits: what each frame starts from is
wrong by then, and each map begins with it again. On one street that lasted for eighteen seconds."""

_NOTHING_FITS_M: Final = 0.95 * RESIDUAL_REACH_M
"""Most of what stands is farther from where it was than is looked for."""


class KissOdometry:
    """KISS-ICP (`kiss_map.py`) on maps that begin by the clock (`time_anchored_maps.py`).

    No frame is ever refused: one that cannot be registered gets the predicted pose and says so.

    The first frames of a stretch are held back for a third of a second. KISS-ICP starts from no
    motion, and between rails and noise walls 2 m a frame fit as well without moving: every speed
    that the first two frames allow is tried beside it, and the one kept that free space contradicts
    least. Where another one is contradicted hardly more, poses are doubted, and both are looked at
    again each second, until one is clearly better, five times at most. What was not believed before
    is doubted until two more looks bear it out.

    State starts anew after a gap of more than 0.5 s, after time that does not rise, when a
    registration fails, and after half a second of poses that no car can take, or at which nothing
    fits: the pose then goes on from the last one, so what lies between is unknown.
    """

    @property
    def version(self) -> str:
        """`kiss-icp@digest` of code and settings."""
        return version_of("kiss-icp")

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        """Yield each frame with its pose, the first ones once it is known how they move."""
        run, held, begun = Run(), list[LidarFrame](), False
        unsure: Unsure | None = None
        astray = _Astray()
        for frame in frames:
            if not _follows(held[-1].stamp_ns if held else run.stamp_ns, frame):
                if held:
                    run, posed, unsure = _begin(run, held)
                    yield from posed
                held, begun, astray = [], False, _Astray()
            if begun:
                now = run.pose(frame)
                if unsure is not None:
                    run, now, unsure = unsure.look_again(run, now)
                yield now
                if astray.too_long(now):
                    run, begun, unsure = run.anew(why=f"astray for {_ASTRAY_S} s"), False, None
                continue
            held.append(frame)
            if span_s(held) >= BEGINNING_S or len(held) == _MOST_HELD:
                run, posed, unsure = _begin(run, held)
                yield from posed
                held, begun = [], True
        if held:
            yield from _begin(run, held)[1]


class _Astray:
    """Since when poses go where no car goes, or where nothing fits."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def too_long(self, now: PosedFrame) -> bool:
        """Take in a frame, say whether to begin anew, and then count from the next one."""
        stamp_ns = now.frame.stamp_ns
        wild = now.jumped or now.static_residual_m >= _NOTHING_FITS_M
        if now.odometry is not OdometryState.LOST or not wild:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = stamp_ns
        elif stamp_ns - self._since_ns >= _ASTRAY_S * NS_PER_S:
            self._since_ns = None
            return True
        return False


def _begin(before: Run, held: Sequence[LidarFrame]) -> tuple[Run, list[PosedFrame], Unsure | None]:
    """Register the first frames of a stretch; from no motion, unless another start is better."""
    run = before.anew()
    posed = [run.pose(frame) for frame in held]
    if len(held) < FEWEST_HELD:
        return run, posed, None
    found = likeliest(run, posed, before.anew)
    if not found.alike:
        return found.run, found.posed, None
    return found.run, [doubted(each, found.alike) for each in found.posed], Unsure(found)


def _follows(last_ns: int | None, frame: LidarFrame) -> bool:
    """Whether a frame is near enough in time to the one before it, if there is any."""
    return last_ns is None or 0.0 < (frame.stamp_ns - last_ns) / NS_PER_S <= MAX_GAP_S
