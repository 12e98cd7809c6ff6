"""Logs of a ring of points with global fixes, written by the encoders of the mcap libraries."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set
from mcap_ros2._dynamic import serialize_dynamic

from schemas.arrays import NS_PER_S
from tests.tiny_logs import BEGIN_NS, CLOUD_TYPE, Said, drive
from workers.ingest.ros_definitions import ROS2_DEFINITIONS

FIXES = "/gps/fix"
MUNICH = (48.137, 11.575)
SPEED_M_PER_S = 10.0

_STAMP = "\n" + "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
NAV_SAT_FIX = """\
uint8 COVARIANCE_TYPE_UNKNOWN = 0
uint8 COVARIANCE_TYPE_KNOWN = 3
std_msgs/Header header
sensor_msgs/NavSatStatus status
float64 latitude
float64 longitude
float64 altitude
float64[9] position_covariance
uint8 position_covariance_type
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: sensor_msgs/NavSatStatus
int8 STATUS_NO_FIX = -1
int8 STATUS_FIX = 0
int8 status
uint16 SERVICE_GPS = 1
uint16 service
"""
"""Definition as ROS 2 Humble ships it, with constants that ours does not have."""


@dataclass(frozen=True)
class Fix:
    """Content of one message of a receiver."""

    stamp_ns: int
    latitude_deg: float
    longitude_deg: float
    status: int = 0


def driving(
    seconds: float,
    *,
    rate_hz: float = 5.0,
    heading_rad: float = 0.0,
    begin: tuple[float, float] = MUNICH,
) -> list[Fix]:
    """A straight drive from a place; the heading is counted from east to the left."""
    found = []
    for number in range(round(seconds * rate_hz) + 1):
        way_m = SPEED_M_PER_S * number / rate_hz
        north, east = way_m * np.sin(heading_rad), way_m * np.cos(heading_rad)
        latitude = begin[0] + north / 111_320.0
        longitude = begin[1] + east / 111_320.0 / np.cos(np.radians(begin[0]))
        stamp_ns = BEGIN_NS + round(number / rate_hz * NS_PER_S)
        found.append(Fix(stamp_ns, float(latitude), float(longitude)))
    return found


def nav_sat_fix() -> Callable[[Fix], bytes]:
    """An encoder of `sensor_msgs/msg/NavSatFix` in CDR."""
    encode = serialize_dynamic("sensor_msgs/NavSatFix", NAV_SAT_FIX)["sensor_msgs/NavSatFix"]

    def write(fix: Fix) -> bytes:
        seconds, rest = divmod(fix.stamp_ns, NS_PER_S)
        return bytes(
            encode(
                {
                    "header": {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": "gps"},
                    "status": {"status": fix.status, "service": 1},
                    "latitude": fix.latitude_deg,
                    "longitude": fix.longitude_deg,
                    "altitude": 520.0,
                    "position_covariance": [0.0] * 9,
                    "position_covariance_type": 0,
                }
            )
        )

    return write


def location_fix(fix: Fix) -> bytes:
    """Encode a `foxglove.LocationFix` in protobuf."""
    message: Any = LocationFix(
        frame_id="gps", latitude=fix.latitude_deg, longitude=fix.longitude_deg, altitude=520.0
    )
    message.timestamp.FromNanoseconds(fix.stamp_ns)
    return bytes(message.SerializeToString())


def location_fix_json(fix: Fix) -> bytes:
    """Encode a `foxglove.LocationFix` in JSON."""
    seconds, rest = divmod(fix.stamp_ns, NS_PER_S)
    return json.dumps(
        {
            "timestamp": {"sec": seconds, "nsec": rest},
            "frame_id": "gps",
            "latitude": fix.latitude_deg,
            "longitude": fix.longitude_deg,
        }
    ).encode()


def odometry(frame: str) -> Callable[[Fix], bytes]:
    """An encoder of `nav_msgs/msg/Odometry`, with latitude and longitude as x and y in metres."""
    name = "nav_msgs/Odometry"
    encode = serialize_dynamic(name, ROS2_DEFINITIONS[name] + _STAMP)[name]

    def write(fix: Fix) -> bytes:
        seconds, rest = divmod(fix.stamp_ns, NS_PER_S)
        axes = {"x": fix.latitude_deg, "y": fix.longitude_deg, "z": 0.0}
        still = {"linear": dict.fromkeys("xyz", 0.0), "angular": dict.fromkeys("xyz", 0.0)}
        turn = {**dict.fromkeys("xyz", 0.0), "w": 1.0}
        return bytes(
            encode(
                {
                    "header": {"stamp": {"sec": seconds, "nanosec": rest}, "frame_id": frame},
                    "child_frame_id": "base_link",
                    "pose": {
                        "pose": {"position": axes, "orientation": turn},
                        "covariance": [0.0] * 36,
                    },
                    "twist": {"twist": still, "covariance": [0.0] * 36},
                }
            )
        )

    return write


@dataclass(frozen=True)
class Kind:
    """Encoding of messages, their type, and its schema."""

    encoding: str
    name: str
    schema_encoding: str
    schema: bytes = b""


CLOUDS = Kind("cdr", CLOUD_TYPE, "ros2msg")
ROS_FIX = Kind("cdr", "sensor_msgs/msg/NavSatFix", "ros2msg", NAV_SAT_FIX.encode())
PROTO_FIX = Kind(
    "protobuf",
    "foxglove.LocationFix",
    "protobuf",
    build_file_descriptor_set(LocationFix).SerializeToString(),
)
JSON_FIX = Kind("json", "foxglove.LocationFix", "jsonschema", b"{}")
ODOMETRY = Kind("cdr", "nav_msgs/msg/Odometry", "ros2msg")


def log_with(
    fixes: Sequence[Fix],
    kind: Kind = ROS_FIX,
    encode: Callable[[Fix], bytes] | None = None,
    *,
    seconds: float = 4.0,
    delay_ns: int = 0,
    topic: str = FIXES,
) -> bytes:
    """Write a log of clouds and fixes by log time, in chunks that hold both."""
    encode = encode or nav_sat_fix()
    said = [(CLOUDS, each) for each in drive(seconds)]
    said += [(kind, Said(topic, each.stamp_ns + delay_ns, encode(each))) for each in fixes]
    out = BytesIO()
    writer = Writer(out, chunk_size=30_000)
    writer.start(profile="", library="test")
    channels: dict[str, int] = {}
    for of, each in sorted(said, key=lambda one: one[1].log_time_ns):
        if each.topic not in channels:
            schema = writer.register_schema(of.name, of.schema_encoding, of.schema)
            channels[each.topic] = writer.register_channel(
                topic=each.topic, message_encoding=of.encoding, schema_id=schema
            )
        writer.add_message(
            channels[each.topic], each.log_time_ns, each.data, publish_time=each.log_time_ns
        )
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()
