"""Recorded motion of the car: its topic in a log, and its speed and turn rate over time."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, RecordedMotion
from schemas.work import Channel
from workers.ingest.camera_messages import frame_and_stamp
from workers.ingest.decoding import MessageUnreadableError, can_decode, decode_message, ros_type
from workers.ingest.messages import RawMessage
from workers.ingest.topics import Topic
from workers.ingest.transforms import member

KINDS: Final = (
    ("nav_msgs/Odometry", ""),
    ("geometry_msgs/TwistWithCovarianceStamped", ""),
    ("geometry_msgs/TwistStamped", ""),
    ("", "foxglove.PoseInFrame"),
)
"""ROS and Foxglove types, the least ambiguous first: a twist may be a command, a pose a goal."""

MAX_SPEED_M_PER_S: Final = 150.0
MAX_TURN_RAD_PER_S: Final = 60.0
"""Largest speed and turn rate; beyond them a message is damaged.

Wrong units, km/h or degrees, stay below: they are noticed because they never agree."""

MAX_APART_NS: Final = NS_PER_S // 4
"""Largest gap between samples across which motion is interpolated, nanoseconds."""

HELD_NS: Final = NS_PER_S // 20
"""Time for which the first and the last sample are valid beyond themselves, nanoseconds."""

MAX_STEP_NS: Final = NS_PER_S // 2
LONGEST_SWEEP_NS: Final = NS_PER_S // 10
_MAX_CLOCK_NS: Final = NS_PER_S // 2
_KEPT_NS: Final = 2 * NS_PER_S
_INSTANTS: Final = 9


def find_motion(topics: Sequence[Topic], wanted: str) -> Channel | None:
    """Find the topic of the car's recorded motion.

    Args:
        topics: All of the log.
        wanted: The setting `odometry_topic`.

    Returns:
        Its channel; the first by kind, then by name, where several are. None where none is.
    """
    found = [
        (kind, topic.channel.topic, topic.channel)
        for topic in topics
        if topic.messages and wanted in ("", topic.channel.topic)
        for kind in _kinds(topic.channel)
    ]
    return min(found, key=lambda each: each[:2])[2] if found else None


def _kinds(channel: Channel) -> list[int]:
    return [
        number
        for number, (ros, foxglove) in enumerate(KINDS)
        if can_decode(channel, ros=ros, foxglove=foxglove)
    ]


@dataclass(frozen=True, slots=True)
class _Sample:
    """Motion of one message, or between two poses.

    Attributes:
        header_ns: Its own stamp; 0 where it has none.
        log_time_ns: Its log time.
        speed_m_per_s: Magnitude.
        turn_rad_per_s: Magnitude, about the vertical.
    """

    header_ns: int
    log_time_ns: int
    speed_m_per_s: float
    turn_rad_per_s: float


@dataclass(frozen=True, slots=True, eq=False)
class _Pose:
    header_ns: int
    log_time_ns: int
    position_m: NDArray[np.float64]
    yaw_rad: float


class MotionLog:
    """The messages of the last seconds, for the mean motion between two instants.

    A twist counts if the topic ever has a non-zero one; some sources fill in the pose only.
    """

    def __init__(self) -> None:
        self._samples: deque[_Sample] = deque()
        self._pose: _Pose | None = None
        self._has_twist = False

    def add(self, message: RawMessage) -> None:
        """Add a message, in the order of log times.

        Raises:
            MessageUnreadableError: If it cannot be decoded, or its motion is impossible for a car.
        """
        sample = self._read(message)
        if sample is None:
            return
        said = (sample.speed_m_per_s, sample.turn_rad_per_s)
        if not (said[0] <= MAX_SPEED_M_PER_S and said[1] <= MAX_TURN_RAD_PER_S):  # NaN neither
            raise MessageUnreadableError(
                f"{said[0]:.3g} m/s and {said[1]:.3g} rad/s are no motion of a car "
                f"({message.channel.topic}, logged at {message.log_time_ns})"
            )
        self._samples.append(sample)
        while message.log_time_ns - self._samples[0].log_time_ns > _KEPT_NS:
            self._samples.popleft()

    def between(self, start_ns: int, end_ns: int, *, delay_ns: int) -> RecordedMotion | None:
        """Return the mean motion of the car between two instants.

        Args:
            start_ns: First instant, by the clock of the lidar.
            end_ns: Last one.
            delay_ns: Time from that clock to the log times of the lidar's frames. Where the
                topic's own stamps are of another clock, log times relate both.

        Returns:
            None where there are no messages at the time, or too few.
        """
        if not 0 < end_ns - start_ns <= MAX_STEP_NS or not self._samples:
            return None
        samples = sorted(self._samples, key=lambda each: _time_ns(each, delay_ns))
        time = np.array([_time_ns(each, delay_ns) - start_ns for each in samples], np.float64)
        instants = np.linspace(0.0, float(end_ns - start_ns), _INSTANTS)
        if not _known(time, instants):
            return None
        speed = np.interp(
            instants, time, _median_filtered([each.speed_m_per_s for each in samples])
        )
        turn = np.interp(
            instants, time, _median_filtered([each.turn_rad_per_s for each in samples])
        )
        return RecordedMotion(float(speed.mean()), float(turn.mean()))

    def _read(self, message: RawMessage) -> _Sample | None:
        decoded = decode_message(message)
        try:
            _, header_ns = frame_and_stamp(decoded)
            kind = ros_type(message.channel).rpartition("/")[2]
            twist = _member_of(decoded, "twist", deep=kind != "TwistStamped")
            pose = _member_of(decoded, "pose", deep=kind == "Odometry")
            moved = None if pose is None else self._follow(pose, header_ns, message.log_time_ns)
            if twist is None:
                return moved
            speed = float(np.linalg.norm(_vector(member(twist, "linear"))))
            turn = abs(float(member(member(twist, "angular"), "z")))
        except (KeyError, AttributeError, TypeError, ValueError, OverflowError) as error:
            raise MessageUnreadableError(
                f"cannot read {message.channel.schema_name}: {type(error).__name__}: {error} "
                f"({message.channel.topic}, logged at {message.log_time_ns})"
            ) from error
        self._has_twist |= bool(speed or turn)
        if moved is not None and not self._has_twist:
            return moved
        return _Sample(header_ns, message.log_time_ns, speed, turn)

    def _follow(self, pose: Any, header_ns: int, log_time_ns: int) -> _Sample | None:
        """Return the motion between the last pose and this one, at the instant between them."""
        now = _Pose(
            header_ns,
            log_time_ns,
            _vector(member(pose, "position")),
            _yaw_rad(member(pose, "orientation")),
        )
        if not np.isfinite([*now.position_m, now.yaw_rad]).all():
            return None
        before, self._pose = self._pose, now
        if before is None:
            return None
        log_step_ns = log_time_ns - before.log_time_ns
        step_ns = header_ns - before.header_ns if header_ns and before.header_ns else log_step_ns
        if not 0 < step_ns <= MAX_STEP_NS:
            return None
        per_s = NS_PER_S / step_ns
        turned = (now.yaw_rad - before.yaw_rad + np.pi) % (2 * np.pi) - np.pi
        return _Sample(
            header_ns - step_ns // 2 if header_ns else 0,
            log_time_ns - log_step_ns // 2,
            float(np.linalg.norm(now.position_m - before.position_m)) * per_s,
            abs(float(turned)) * per_s,
        )


def middle_ns(frame: LidarFrame, *, step_ns: int) -> int:
    """Return the time of a frame's pose: the middle of its sweep, by its points or its stamp."""
    offset_ns = frame.offset_ns[frame.valid_mask]
    if frame.has_point_time and len(offset_ns):
        return frame.stamp_ns + (int(offset_ns.min()) + int(offset_ns.max())) // 2
    half_ns = min(step_ns, LONGEST_SWEEP_NS) // 2
    return frame.stamp_ns + {"start": half_ns, "middle": 0, "end": -half_ns}[frame.stamp_at]


def _time_ns(sample: _Sample, delay_ns: int) -> int:
    """Return the time of a sample, by the clock of the lidar."""
    apart_ns = sample.log_time_ns - sample.header_ns - delay_ns
    if sample.header_ns and abs(apart_ns) <= _MAX_CLOCK_NS:
        return sample.header_ns
    return sample.log_time_ns - delay_ns


def _known(time: NDArray[np.float64], instants: NDArray[np.float64]) -> bool:
    """Return True if each instant is between two close samples, or right next to one."""
    after = np.searchsorted(time, instants)
    later = np.where(after < len(time), time[np.minimum(after, len(time) - 1)], np.inf)
    earlier = np.where(after > 0, time[np.maximum(after, 1) - 1], -np.inf)
    next_to_one = np.minimum(later - instants, instants - earlier) <= HELD_NS
    return bool((next_to_one | (later - earlier <= MAX_APART_NS)).all())


def _median_filtered(values: Sequence[float]) -> NDArray[np.float64]:
    """Replace each value by the median of it and its neighbours: single ones may be wrong."""
    filtered = np.array(values, np.float64)
    if len(filtered) > 2:
        filtered[1:-1] = np.median([filtered[:-2], filtered[1:-1], filtered[2:]], axis=0)
    return filtered


def _member_of(message: Any, name: str, *, deep: bool) -> Any:
    """Read the twist or pose of a message, without its covariance; None where there is none."""
    has = name in message if isinstance(message, dict) else hasattr(message, name)
    if not has:
        return None
    return member(member(message, name), name) if deep else member(message, name)


def _vector(message: Any) -> NDArray[np.float64]:
    return np.array([float(member(message, name)) for name in "xyz"])


def _yaw_rad(message: Any) -> float:
    x, y, z, w = (float(member(message, name)) for name in "xyzw")
    return float(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))
