"""Lidar odometry with KISS-ICP: a pose per frame, and its health."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from workers.odometry.motion_hypotheses import (
    DECISION_S,
    MIN_BUFFERED,
    AmbiguousMotion,
    degraded,
    most_likely_motion,
    span_s,
)
from workers.odometry.registration_pass import MAX_GAP_S, RESIDUAL_REACH_M, RegistrationPass
from workers.part_version import version_of

_MAX_BUFFERED: Final = 10
_BAD_POSES_S: Final = 0.5
"""Time of impossible motion, or of no fit, after which a stretch ends, seconds.

By then the prediction of each frame is wrong, and each new map begins with it. On one street such a
state lasted for eighteen seconds."""

_NOTHING_FITS_M: Final = 0.95 * RESIDUAL_REACH_M
"""Residual at which most static points are beyond the search radius, metres."""


class KissOdometry:
    """KISS-ICP (`kiss_map.py`) on time-anchored maps (`time_anchored_maps.py`).

    No frame is ever refused: one that cannot be registered gets the predicted pose and a state.

    The first frames of a stretch are held back for a third of a second. KISS-ICP starts from no
    motion, and between rails and noise walls a step of 2 m per frame fits as well as none. All
    speeds that the first two frames allow are therefore compared, and free space selects the one
    it contradicts least. Where another one is contradicted hardly more, poses are marked as
    degraded. Both are compared again each second until one is clearly better, five times at most. A
    motion that replaces another stays marked until two more tests confirm it.

    The state is reset after a gap of more than 0.5 s, after time that does not rise, and when a
    registration fails. It is also reset after half a second of poses that no car can take, or at
    which nothing fits. The pose then continues from the last one; the motion between is unknown.
    """

    @property
    def version(self) -> str:
        """`kiss-icp@digest` of code and settings."""
        return version_of("kiss-icp")

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        """Yield each frame with its pose, the first ones once their motion is decided."""
        registration, buffered, started = RegistrationPass(), list[LidarFrame](), False
        ambiguous: AmbiguousMotion | None = None
        bad_poses = _BadPoses()
        for frame in frames:
            if not _follows(buffered[-1].stamp_ns if buffered else registration.stamp_ns, frame):
                if buffered:
                    registration, posed, ambiguous = _begin(registration, buffered)
                    yield from posed
                buffered, started, bad_poses = [], False, _BadPoses()
            if started:
                now = registration.pose(frame)
                if ambiguous is not None:
                    registration, now, ambiguous = ambiguous.test_again(registration, now)
                yield now
                if bad_poses.too_long(now):
                    registration = registration.restart(why=f"astray for {_BAD_POSES_S} s")
                    started, ambiguous = False, None
                continue
            buffered.append(frame)
            if span_s(buffered) >= DECISION_S or len(buffered) == _MAX_BUFFERED:
                registration, posed, ambiguous = _begin(registration, buffered)
                yield from posed
                buffered, started = [], True
        if buffered:
            yield from _begin(registration, buffered)[1]


class _BadPoses:
    """Start of the present run of impossible or unfitting poses."""

    def __init__(self) -> None:
        self._since_ns: int | None = None

    def too_long(self, now: PosedFrame) -> bool:
        """Add a frame; return True when the run of bad poses is too long, and forget it."""
        stamp_ns = now.frame.stamp_ns
        impossible = now.jumped or now.static_residual_m >= _NOTHING_FITS_M
        if now.odometry is not OdometryState.LOST or not impossible:
            self._since_ns = None
        elif self._since_ns is None:
            self._since_ns = stamp_ns
        elif stamp_ns - self._since_ns >= _BAD_POSES_S * NS_PER_S:
            self._since_ns = None
            return True
        return False


def _begin(
    before: RegistrationPass, buffered: Sequence[LidarFrame]
) -> tuple[RegistrationPass, list[PosedFrame], AmbiguousMotion | None]:
    """Register the first frames of a stretch, from no motion unless another start is better."""
    registration = before.restart()
    posed = [registration.pose(frame) for frame in buffered]
    if len(buffered) < MIN_BUFFERED:
        return registration, posed, None
    found = most_likely_motion(registration, posed, before.restart)
    if not found.alternative:
        return found.registration, found.posed, None
    return (
        found.registration,
        [degraded(each, found.alternative) for each in found.posed],
        AmbiguousMotion(found),
    )


def _follows(last_ns: int | None, frame: LidarFrame) -> bool:
    """Return True if a frame is close enough in time to the one before it, or the first."""
    return last_ns is None or 0.0 < (frame.stamp_ns - last_ns) / NS_PER_S <= MAX_GAP_S
