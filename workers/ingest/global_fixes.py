"""Global fixes of the car: their topic in a log, and the fixes of its messages over time."""

import math
from collections import Counter, deque
from collections.abc import Sequence
from typing import Any, Final

from schemas.arrays import NS_PER_S
from schemas.bounds import MAX_NAME
from schemas.frame import RecordedFix
from schemas.surroundings import EARTH, METRES_PER_DEGREE
from schemas.visible import visible
from schemas.work import Channel
from workers.ingest.camera_messages import frame_and_stamp
from workers.ingest.decoding import MessageUnreadableError, can_decode, decode_message, ros_type
from workers.ingest.messages import RawMessage
from workers.ingest.topics import Topic
from workers.ingest.transforms import member

NAV_SAT_FIX: Final = "sensor_msgs/NavSatFix"
ODOMETRY: Final = "nav_msgs/Odometry"

DETECTED: Final = ((NAV_SAT_FIX, ""), ("", "foxglove.LocationFix"))
"""ROS and Foxglove types of latitude and longitude, which are global by definition."""

NAMED: Final = (*DETECTED, (ODOMETRY, ""), ("", "foxglove.PoseInFrame"))
"""Types that the setting `place_topic` may name.

Odometry is mostly relative to the start of a drive; only the user knows that its frame is shared.
"""

NOT_USED: Final = "none"
"""Value of the setting `place_topic` by which no place is recorded."""

FARTHEST_M: Final = 1e8
"""Largest coordinate of a frame in metres, beyond the size of the Earth."""

MAX_SPEED_M_PER_S: Final = 150.0
SLACK_M: Final = 50.0
"""A fix farther from the last one than a car drives in the time, and this slack, jumps."""

MAX_WAITING: Final = 10_000
"""Fixes that wait for the next cloud; a gap of clouds of 100 s at 100 Hz."""

WITHOUT_FIX: Final = "without a fix"
OUTSIDE: Final = "beyond the Earth"
JUMPING: Final = "that jump"
"""Causes for which fixes are not used."""

_MAX_CLOCK_NS: Final = NS_PER_S // 2


def find_fixes(topics: Sequence[Topic], wanted: str) -> Channel | None:
    """Find the topic of the car's global fixes.

    Args:
        topics: All of the log.
        wanted: The setting `place_topic`; odometry has to be named, and is never detected.

    Returns:
        Its channel; the first by kind, then by name, where several are. None where none is.
    """
    if wanted == NOT_USED:
        return None
    kinds = NAMED if wanted else DETECTED
    found = [
        (number, topic.channel.topic, topic.channel)
        for topic in topics
        if topic.messages and wanted in ("", topic.channel.topic)
        for number, (ros, foxglove) in enumerate(kinds)
        if can_decode(topic.channel, ros=ros, foxglove=foxglove)
    ]
    return min(found, key=lambda each: each[:2])[2] if found else None


_Logged = tuple[int, RecordedFix]
"""Log time, nanoseconds, and a fix with its own stamp, 0 without."""


class FixLog:
    """Fixes that wait for the next cloud, and a count of those that are not used, by cause."""

    def __init__(self) -> None:
        self.ignored: Counter[str] = Counter()
        self.used = 0
        self._waiting: deque[_Logged] = deque(maxlen=MAX_WAITING)
        self._last: _Logged | None = None
        self._doubted: _Logged | None = None

    def add(self, message: RawMessage) -> None:
        """Add a message, in the order of log times.

        A fix that jumps away from the one before, and the first one, wait for the next: where both
        agree, the car is there, as after a tunnel; else the one that waited is ignored.

        Raises:
            MessageUnreadableError: If it cannot be decoded.
        """
        found = self._read(message)
        if isinstance(found, str):
            self.ignored[found] += 1
            return
        logged, doubted = (message.log_time_ns, found), self._doubted
        if self._last is not None and not _jumps(self._last, logged):
            self.ignored[JUMPING] += doubted is not None
            self._take(logged)
        elif doubted is not None and not _jumps(doubted, logged):
            self._take(doubted, logged)
        else:
            self.ignored[JUMPING] += doubted is not None
            self._doubted = logged

    def taken(self, *, delay_ns: int) -> tuple[RecordedFix, ...]:
        """Return the fixes since the last call, by the clock of the lidar.

        Args:
            delay_ns: Time from that clock to the log times of the lidar's frames. Where the
                topic's own stamps are of another clock, log times relate both.
        """
        found = tuple(
            RecordedFix(_time_ns(fix.time_ns, log_time_ns, delay_ns), fix.frame, fix.at)
            for log_time_ns, fix in self._waiting
        )
        self._waiting.clear()
        return found

    def sentence(self, topic: str) -> str:
        """Describe what is wrong with the fixes; empty where nothing is.

        A fix that its receiver calls none is no fault: cars drive through tunnels.
        """
        wrong = {
            cause: count for cause, count in self.ignored.items() if count and cause != WITHOUT_FIX
        }
        if not wrong:
            return ""
        causes = ", ".join(f"{count} {cause}" for cause, count in sorted((+self.ignored).items()))
        ignored = sum(self.ignored.values())
        return f"{ignored} of {ignored + self.used} global fixes are not used: {causes} ({topic})"

    def _take(self, *logged: _Logged) -> None:
        self._last, self._doubted = logged[-1], None
        self._waiting.extend(logged)
        self.used += len(logged)

    def _read(self, message: RawMessage) -> RecordedFix | str:
        """Return the fix of a message with its own stamp, 0 without; or why it is not used."""
        decoded = decode_message(message)
        try:
            frame, stamp_ns = frame_and_stamp(decoded)
            if ros_type(message.channel) == NAV_SAT_FIX and int(decoded.status.status) < 0:
                return WITHOUT_FIX
            is_metric = _is_metric(message.channel)
            at = _position(decoded) if is_metric else _degrees(decoded)
        except (KeyError, AttributeError, TypeError, ValueError, OverflowError) as error:
            raise MessageUnreadableError(
                f"cannot read {message.channel.schema_name}: {type(error).__name__}: {error} "
                f"({message.channel.topic}, logged at {message.log_time_ns})"
            ) from error
        if not all(map(math.isfinite, at)):
            return "not finite"
        if is_metric:
            frame = visible(frame.strip("/"), limit=MAX_NAME)
            if not frame or frame == EARTH:
                return "without the name of a frame"
            return RecordedFix(stamp_ns, frame, at) if max(map(abs, at)) <= FARTHEST_M else OUTSIDE
        if at == (0.0, 0.0):
            return WITHOUT_FIX  # a receiver that was never set
        is_on_earth = abs(at[0]) <= 90.0 and abs(at[1]) <= 180.0
        return RecordedFix(stamp_ns, EARTH, at) if is_on_earth else OUTSIDE


def _degrees(decoded: Any) -> tuple[float, float]:
    return float(member(decoded, "latitude")), float(member(decoded, "longitude"))


def _is_metric(channel: Channel) -> bool:
    """Return True for a channel of positions in metres."""
    return not any(can_decode(channel, ros=ros, foxglove=foxglove) for ros, foxglove in DETECTED)


def _position(decoded: Any) -> tuple[float, float]:
    """Read the position of a pose; that of odometry lies one deeper, next to its covariance."""
    pose = member(decoded, "pose")
    position = member(pose.pose if hasattr(pose, "covariance") else pose, "position")
    return float(member(position, "x")), float(member(position, "y"))


def _jumps(before: _Logged, now: _Logged) -> bool:
    """Return True if no car drives from one fix to the next in their time."""
    (logged_ns, start), (log_time_ns, end) = before, now
    if start.frame != end.frame:
        return True
    first, second = end.at[0] - start.at[0], end.at[1] - start.at[1]
    if end.frame == EARTH:
        second = (second + 180.0) % 360.0 - 180.0
        first *= METRES_PER_DEGREE
        second *= METRES_PER_DEGREE * math.cos(math.radians(end.at[0]))
    passed_ns = max(log_time_ns - logged_ns, end.time_ns - start.time_ns, 0)
    return math.hypot(first, second) > SLACK_M + MAX_SPEED_M_PER_S * passed_ns / NS_PER_S


def _time_ns(header_ns: int, log_time_ns: int, delay_ns: int) -> int:
    """Return the time of a fix, by the clock of the lidar."""
    is_of_that_clock = abs(log_time_ns - header_ns - delay_ns) <= _MAX_CLOCK_NS
    return header_ns if header_ns and is_of_that_clock else log_time_ns - delay_ns
