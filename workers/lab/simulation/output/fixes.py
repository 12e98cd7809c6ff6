"""Recorded global fixes of a simulated car: a satellite receiver with an error of its own each day.

Streets lie kilometres apart on Earth, each where its seed says, with x to the east.
"""

from collections.abc import Iterator
from typing import Any, Final
from zlib import crc32

import numpy as np
from mcap_ros2.writer import Writer

from schemas.arrays import NS_PER_S
from schemas.surroundings import METRES_PER_DEGREE, metres_per_degree_east
from workers.ingest.ros_definitions import ROS2_DEFINITIONS
from workers.lab.simulation.output.cloud import STAMP_DEFINITION
from workers.lab.simulation.world.street import Street

FIX_TOPIC: Final = "/gps/fix"
NAV_SAT_FIX: Final = "sensor_msgs/msg/NavSatFix"
DEFINITION: Final = ROS2_DEFINITIONS["sensor_msgs/NavSatFix"] + STAMP_DEFINITION

RATE_HZ: Final = 5
_DAILY_M: Final = 1.0
"""Standard deviation of the error that lasts for a drive, each axis, metres."""

_NOISE_M: Final = 0.3
"""Standard deviation of a single fix, each axis, metres."""

_SOUTH_WEST: Final = (47.0, 8.0)
_STREETS_A_SIDE: Final = 200
_APART_DEG: Final = 0.02
"""Streets lie on a square of 4 degrees, 2 km apart in latitude; two may share a place by chance."""


class FixWriter:
    """Writes the fixes of a log in time order, between its clouds."""

    def __init__(self, writer: Writer, street: Street, *, start_ns: int, drive: str) -> None:
        self._writer = writer
        self._schema = writer.register_msgdef(NAV_SAT_FIX, DEFINITION)
        self._messages = fix_messages(street, start_ns=start_ns, drive=drive)
        self._next = next(self._messages, None)

    def write_until(self, stamp_ns: int) -> None:
        """Write the messages up to a time."""
        while self._next is not None and self._next[0] <= stamp_ns:
            at_ns, message = self._next
            self._writer.write_message(FIX_TOPIC, self._schema, message, at_ns, at_ns)
            self._next = next(self._messages, None)


def origin_of(street: Street) -> tuple[float, float]:
    """Return latitude and longitude of the origin of a street's world, degrees."""
    row, column = divmod(crc32(str(street.seed).encode()) % _STREETS_A_SIDE**2, _STREETS_A_SIDE)
    return _SOUTH_WEST[0] + _APART_DEG * row, _SOUTH_WEST[1] + _APART_DEG * column


def fix_messages(
    street: Street, *, start_ns: int, drive: str
) -> Iterator[tuple[int, dict[str, Any]]]:
    """Simulate the fixes of a drive.

    Args:
        street: Street with the drive of the ego.
        start_ns: Time of the beginning, nanoseconds since the Unix epoch.
        drive: Name of the drive, from which its error is drawn.

    Yields:
        Stamp, nanoseconds since the Unix epoch, and fields of a `sensor_msgs/msg/NavSatFix`.
    """
    rng = np.random.default_rng([street.seed, crc32(drive.encode()), 0xF1C5])
    count = int(street.seconds * RATE_HZ) + 1
    at_m = street.ego.pose(np.arange(count) / RATE_HZ)[:, :2]
    at_m = at_m + rng.normal(0.0, _DAILY_M, 2) + rng.normal(0.0, _NOISE_M, (count, 2))
    south, west = origin_of(street)
    east_metres = metres_per_degree_east(south)
    for number, (east_m, north_m) in enumerate(at_m.tolist()):
        stamp_ns = start_ns + number * NS_PER_S // RATE_HZ
        seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
        yield (
            stamp_ns,
            {
                "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": "gps"},
                "status": {"status": 0, "service": 1},
                "latitude": south + north_m / METRES_PER_DEGREE,
                "longitude": west + east_m / east_metres,
                "altitude": 0.0,
                "position_covariance": [
                    _DAILY_M**2,
                    0.0,
                    0.0,
                    0.0,
                    _DAILY_M**2,
                    0.0,
                    0.0,
                    0.0,
                    9.0,
                ],
                "position_covariance_type": 2,
            },
        )
