"""Message rate: separates a lidar's clouds from a flood that later stages could not process."""

from collections import Counter

from schemas.arrays import NS_PER_S
from workers.errors import CloudUnreadableError
from workers.ingest.frames import frame_stamp_ns
from workers.ingest.limits import MAX_CLOUDS_PER_S, MAX_LOGGED_PER_S, MAX_POINTS_PER_S
from workers.ingest.messages import MAX_TIME_NS, RawMessage
from workers.ingest.pointcloud import DecodedCloud


class MessageRate:
    """Clouds and points of one lidar, by second."""

    def __init__(self, *, by_log_time: bool) -> None:
        """Begin with none; `by_log_time` if the stamps of the log are invalid."""
        self._by_log_time = by_log_time
        self._previous_ns: int | None = None
        self._logged: Counter[int] = Counter()
        self._clouds: Counter[int] = Counter()
        self._points: Counter[int] = Counter()

    def check_logged(self, message: RawMessage) -> None:
        """Count a message by its log time, before it is decoded.

        Raises:
            CloudUnreadableError: If there are more within the second than a lidar sends.
        """
        second = message.log_time_ns // NS_PER_S
        self._logged[second] += 1
        if self._logged[second] > MAX_LOGGED_PER_S:
            raise _too_many(f"more than {MAX_LOGGED_PER_S} clouds are logged", message)

    def check_taken(self, cloud: DecodedCloud, message: RawMessage) -> None:
        """Count a cloud by the time that its frame will have.

        Raises:
            CloudUnreadableError: If there are more within the second than a lidar takes.
        """
        stamped = not self._by_log_time and cloud.stamp_ns <= MAX_TIME_NS
        stamp_ns = frame_stamp_ns(
            cloud.stamp_ns if stamped else 0,
            log_time_ns=message.log_time_ns,
            previous_stamp_ns=self._previous_ns,
        )
        second = stamp_ns // NS_PER_S
        if self._clouds[second] >= MAX_CLOUDS_PER_S:
            raise _too_many(f"more than {MAX_CLOUDS_PER_S} clouds are stamped", message)
        if self._points[second] + len(cloud) > MAX_POINTS_PER_S:
            raise _too_many(f"clouds of more than {MAX_POINTS_PER_S} points are stamped", message)
        self._previous_ns = stamp_ns
        self._clouds[second] += 1
        self._points[second] += len(cloud)


def _too_many(what: str, message: RawMessage) -> CloudUnreadableError:
    return CloudUnreadableError(
        f"{what} within one second ({message.channel.topic}, logged at {message.log_time_ns})"
    )
