"""Recorded motion of a simulated car: wheel speed and yaw rate as odometry messages."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from mcap_ros2.writer import Writer

from schemas.arrays import NS_PER_S
from workers.ingest.ros_definitions import ROS2_DEFINITIONS
from workers.lab.simulation.output.cloud import STAMP_DEFINITION
from workers.lab.simulation.world.street import Street

ODOMETRY_TOPIC: Final = "/vehicle/odometry"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
ODOMETRY_DEFINITION: Final = ROS2_DEFINITIONS["nav_msgs/Odometry"] + STAMP_DEFINITION

RATE_HZ: Final = 50
_SCALE: Final = 0.02
"""Standard deviation of the speed's scale error per log, due to the size of the wheels."""

_SPEED_NOISE_M_PER_S: Final = 0.03
_TURN_BIAS_RAD_PER_S: Final = 0.001
_TURN_NOISE_RAD_PER_S: Final = 0.004
_UNKNOWN: Final = [0.0] * 36


class OdometryWriter:
    """Writes the odometry messages of a log in time order, between its clouds."""

    def __init__(self, writer: Writer, street: Street, *, start_ns: int) -> None:
        self._writer = writer
        self._schema = writer.register_msgdef(ODOMETRY, ODOMETRY_DEFINITION)
        self._messages = odometry_messages(street, start_ns=start_ns)
        self._next = next(self._messages, None)

    def write_until(self, stamp_ns: int) -> None:
        """Write the messages up to a time."""
        while self._next is not None and self._next[0] <= stamp_ns:
            at_ns, message = self._next
            self._writer.write_message(ODOMETRY_TOPIC, self._schema, message, at_ns, at_ns)
            self._next = next(self._messages, None)


def odometry_messages(street: Street, *, start_ns: int) -> Iterator[tuple[int, dict[str, Any]]]:
    """Simulate the odometry messages of a drive.

    Args:
        street: Street with the drive of the ego.
        start_ns: Time of the beginning, nanoseconds since the Unix epoch.

    Yields:
        Stamp, nanoseconds since the Unix epoch, and fields of a `nav_msgs/msg/Odometry`.
    """
    rng = np.random.default_rng([street.seed, 0x0D0])
    scale = 1.0 + rng.normal(0.0, _SCALE)
    bias = rng.normal(0.0, _TURN_BIAS_RAD_PER_S)
    count = int(street.seconds * RATE_HZ) + 1
    time_s = np.arange(count) / RATE_HZ
    since_s, until_s = np.maximum(time_s - 0.5 / RATE_HZ, 0.0), time_s + 0.5 / RATE_HZ
    went = street.ego.pose(until_s) - street.ego.pose(since_s)
    moved = went / (until_s - since_s)[:, None]
    heading = street.ego.pose(time_s)[:, 2]
    ahead = moved[:, 0] * np.cos(heading) + moved[:, 1] * np.sin(heading)
    speed = ahead * scale + rng.normal(0.0, _SPEED_NOISE_M_PER_S, count) * (ahead != 0.0)
    turn = moved[:, 2] + bias + rng.normal(0.0, _TURN_NOISE_RAD_PER_S, count)
    yaw = np.concatenate([[0.0], np.cumsum(turn[:-1])]) / RATE_HZ
    x = np.concatenate([[0.0], np.cumsum(speed[:-1] * np.cos(yaw[:-1]))]) / RATE_HZ
    y = np.concatenate([[0.0], np.cumsum(speed[:-1] * np.sin(yaw[:-1]))]) / RATE_HZ
    for number in range(count):
        stamp_ns = start_ns + number * NS_PER_S // RATE_HZ
        yield (
            stamp_ns,
            _message(stamp_ns, x[number], y[number], yaw[number], speed[number], turn[number]),
        )


def _message(
    stamp_ns: int, x_m: float, y_m: float, yaw_rad: float, speed: float, turn: float
) -> dict[str, Any]:
    seconds, nanoseconds = divmod(stamp_ns, NS_PER_S)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": "odom"},
        "child_frame_id": "base_link",
        "pose": {
            "pose": {
                "position": {"x": x_m, "y": y_m, "z": 0.0},
                "orientation": {
                    "x": 0.0,
                    "y": 0.0,
                    "z": float(np.sin(yaw_rad / 2)),
                    "w": float(np.cos(yaw_rad / 2)),
                },
            },
            "covariance": _UNKNOWN,
        },
        "twist": {
            "twist": {
                "linear": {"x": speed, "y": 0.0, "z": 0.0},
                "angular": {"x": 0.0, "y": 0.0, "z": turn},
            },
            "covariance": _UNKNOWN,
        },
    }
