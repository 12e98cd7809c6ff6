"""Cloud types: channels of point clouds, and the needs of lidar data that cannot be read."""

import re
from typing import Final

from schemas.work import Channel
from workers.ingest.decoding import can_decode, ros_type

ROS_CLOUD: Final = "sensor_msgs/PointCloud2"
FOXGLOVE_CLOUD: Final = "foxglove.PointCloud"

_REPUBLISH: Final = "record the driver's sensor_msgs/PointCloud2 topic instead, or convert the log"

_COMPRESSED: Final = (
    "needs a decoder for compressed clouds (Draco, Cloudini or point_cloud_transport): decompress "
    "to sensor_msgs/PointCloud2 before upload"
)

_NEEDS: Final[tuple[tuple[str, str], ...]] = (
    (r"^foxglove\.CompressedPointCloud$", _COMPRESSED),
    (r"(^|/)CompressedPointCloud2?$", _COMPRESSED),
    (r"(^|[./])(draco|cloudini)", _COMPRESSED),
    (r"^velodyne_msgs/Velodyne(Scan|Packet)$",
     f"holds Velodyne packets, which need the sensor's calibration: {_REPUBLISH}"),
    (r"^ouster\w*/(PacketMsg|LidarPacket)$",
     f"holds Ouster packets, which need the sensor's metadata: {_REPUBLISH}"),
    (r"^(hesai|pandar)\w*/\w+$",
     f"holds Hesai packets, which need the sensor's correction file: {_REPUBLISH}"),
    (r"^livox\w*/(CustomMsg|LivoxPacket|LvxPacket)$",
     f"holds Livox's own message: {_REPUBLISH}"),
    (r"^(rslidar|robosense)\w*/\w+$",
     f"holds Robosense packets, which need the sensor's calibration: {_REPUBLISH}"),
    (r"^(nebula_msgs/Nebula\w+|(innovusion|seyond)\w*/\w+)$",
     f"holds a driver's packets, which need the sensor's calibration: {_REPUBLISH}"),
    (r"^sensor_msgs/PointCloud$",
     "holds clouds of the first version, which ROS has deprecated: convert to PointCloud2"),
    (r"^(sensor_msgs/(Multi)?LaserScan|sensor_msgs/MultiEchoLaserScan|foxglove\.LaserScan)$",
     "holds scans of a single plane, in which motion in 3D cannot be judged"),
)  # fmt: skip
"""Type name to the decoder that would be needed; the first match counts."""

_CLOUD_TYPE: Final = re.compile(r"point_?cloud|lidar|\bcloud\b", re.IGNORECASE)
_LIDAR_TOPIC: Final = re.compile(
    r"lidar|point_?cloud|velodyne|ouster|hesai|pandar|livox|rslidar", re.IGNORECASE
)
_KNOWN_ENCODINGS: Final = ("cdr", "ros1", "protobuf", "json")


def is_cloud(channel: Channel) -> bool:
    """Return True for a channel of point clouds that can be decoded here."""
    return can_decode(channel, ros=ROS_CLOUD, foxglove=FOXGLOVE_CLOUD)


def unsupported_reason(channel: Channel) -> str:
    """Return the decoder that a channel with lidar data would need, if it cannot be read here.

    Returns:
        Half a sentence about the channel; empty for clouds that can be read and for channels
        without lidar data.
    """
    if is_cloud(channel):
        return ""
    name = ros_type(channel)
    for pattern, needs in _NEEDS:
        if re.search(pattern, name):
            return needs
    about_clouds = _CLOUD_TYPE.search(name) is not None and not name.startswith("std_msgs/")
    if about_clouds and name in (ROS_CLOUD, FOXGLOVE_CLOUD):
        return (
            f"holds {name} in message encoding {channel.message_encoding!r}: clouds are read in "
            "CDR and ROS 1 (sensor_msgs) and in protobuf and JSON (foxglove)"
        )
    foreign = channel.message_encoding not in _KNOWN_ENCODINGS
    if foreign and (about_clouds or _LIDAR_TOPIC.search(channel.topic)):
        return (
            f"holds {channel.schema_name or 'messages without a schema'} in message encoding "
            f"{channel.message_encoding!r}, which only its vendor can decode: {_REPUBLISH}"
        )
    return ""
