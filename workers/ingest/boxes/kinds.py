"""Kinds of box messages that are read, and the definitions for logs that carry none."""

from base64 import b64decode
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from schemas.predicted_boxes import SCHEMA_NAME
from schemas.work import Channel
from workers.ingest.boxes.definition import (
    DefinitionUnreadableError,
    FieldType,
    parse_definition,
)
from workers.ingest.decoding import ros_type

AUTOWARE_PACKAGES: Final = ("autoware_perception_msgs", "autoware_auto_perception_msgs")
AUTOWARE_TYPES: Final = ("TrackedObjects", "PredictedObjects", "DetectedObjects")

DETECTIONS: Final = "vision_msgs/Detection3DArray"
SCENE_UPDATE: Final = "foxglove.SceneUpdate"

ROS_KINDS: Final = (
    *(f"{package}/{name}" for name in AUTOWARE_TYPES for package in AUTOWARE_PACKAGES),
    DETECTIONS,
)
KINDS: Final = (*ROS_KINDS[:-1], SCHEMA_NAME, DETECTIONS, SCENE_UPDATE)
"""Types in the order of preference, where a log has several: those that state motion come first."""


@dataclass(frozen=True, slots=True)
class BoxKind:
    """Kind of a channel of boxes.

    Attributes:
        rank: Place in `KINDS`.
        name: Type without `/msg/`.
    """

    rank: int
    name: str


def box_kind(channel: Channel) -> BoxKind | None:
    """Return the kind of a channel of boxes; None for any other channel."""
    encoding, name = channel.message_encoding, ros_type(channel)
    if name not in KINDS:
        return None
    readable = {
        SCENE_UPDATE: encoding in ("protobuf", "json"),
        SCHEMA_NAME: encoding == "json",
    }.get(name, encoding in ("cdr", "ros1"))
    return BoxKind(KINDS.index(name), name) if readable else None


@lru_cache(maxsize=32)
def members_of(type_name: str, encoding: str, schema_base64: str) -> tuple[FieldType, ...]:
    """Return the fields of a ROS message of boxes, by the log's definition or by ours.

    Args:
        type_name: `package/Type`.
        encoding: Encoding of the schema; only `ros1msg` and `ros2msg` are definitions.
        schema_base64: Its bytes.

    Raises:
        DefinitionUnreadableError: If the log's definition cannot be read, or it has none and the
            type is not known here.
    """
    if encoding in ("ros1msg", "ros2msg") and schema_base64:
        text = b64decode(schema_base64).decode("utf-8", errors="replace")
        return parse_definition(text, type_name)
    if type_name not in OURS:
        raise DefinitionUnreadableError(
            f"the log has no definition of {type_name} in the form ros2msg"
        )
    return parse_definition(OURS[type_name], type_name)


_SEPARATOR: Final = "\n" + "=" * 80 + "\n"
_COMMON: Final = (
    "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
    "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z",
    "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z",
    "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "MSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance",
    "MSG: geometry_msgs/Twist\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "MSG: geometry_msgs/TwistWithCovariance\ngeometry_msgs/Twist twist\nfloat64[36] covariance",
    "MSG: geometry_msgs/Accel\ngeometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "MSG: geometry_msgs/AccelWithCovariance\ngeometry_msgs/Accel accel\nfloat64[36] covariance",
    "MSG: geometry_msgs/Point32\nfloat32 x\nfloat32 y\nfloat32 z",
    "MSG: geometry_msgs/Polygon\ngeometry_msgs/Point32[] points",
    "MSG: unique_identifier_msgs/UUID\nuint8[16] uuid",
)
_VISION: Final = (
    "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
    "MSG: vision_msgs/Detection3D\nstd_msgs/Header header\n"
    "vision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\nstring id",
    "MSG: vision_msgs/ObjectHypothesisWithPose\nvision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "MSG: vision_msgs/ObjectHypothesis\nstring class_id\nfloat64 score",
    "MSG: vision_msgs/BoundingBox3D\ngeometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
)
_AUTOWARE: Final = (
    "MSG: {p}/ObjectClassification\nuint8 label\nfloat32 probability",
    "MSG: {p}/Shape\nuint8 type\ngeometry_msgs/Polygon footprint\ngeometry_msgs/Vector3 dimensions",
    "MSG: {p}/PredictedPath\ngeometry_msgs/Pose[<=100] path\n"
    "builtin_interfaces/Duration time_step\nfloat32 confidence",
    "MSG: {p}/DetectedObject\nfloat32 existence_probability\n"
    "{p}/ObjectClassification[] classification\n{p}/DetectedObjectKinematics kinematics\n"
    "{p}/Shape shape",
    "MSG: {p}/DetectedObjectKinematics\n"
    "geometry_msgs/PoseWithCovariance pose_with_covariance\nbool has_position_covariance\n"
    "uint8 orientation_availability\ngeometry_msgs/TwistWithCovariance twist_with_covariance\n"
    "bool has_twist\nbool has_twist_covariance",
    "MSG: {p}/TrackedObject\nunique_identifier_msgs/UUID object_id\nfloat32 existence_probability\n"
    "{p}/ObjectClassification[] classification\n{p}/TrackedObjectKinematics kinematics\n"
    "{p}/Shape shape",
    "MSG: {p}/PredictedObject\nunique_identifier_msgs/UUID object_id\n"
    "float32 existence_probability\n{p}/ObjectClassification[] classification\n"
    "{p}/PredictedObjectKinematics kinematics\n{p}/Shape shape",
    "MSG: {p}/PredictedObjectKinematics\n"
    "geometry_msgs/PoseWithCovariance initial_pose_with_covariance\n"
    "geometry_msgs/TwistWithCovariance initial_twist_with_covariance\n"
    "geometry_msgs/AccelWithCovariance initial_acceleration_with_covariance\n"
    "{p}/PredictedPath[<=10] predicted_paths",
)
_TRACKED_KINEMATICS: Final = {
    AUTOWARE_PACKAGES[0]: "MSG: {p}/TrackedObjectKinematics\n"
    "geometry_msgs/PoseWithCovariance pose_with_covariance\n"
    "geometry_msgs/TwistWithCovariance twist_with_covariance\n"
    "geometry_msgs/AccelWithCovariance acceleration_with_covariance\n"
    "uint8 orientation_availability\nbool is_stationary",
    AUTOWARE_PACKAGES[1]: "MSG: {p}/TrackedObjectKinematics\n"
    "geometry_msgs/PoseWithCovariance pose_with_covariance\nuint8 orientation_availability\n"
    "geometry_msgs/TwistWithCovariance twist_with_covariance\n"
    "geometry_msgs/AccelWithCovariance acceleration_with_covariance\nbool is_stationary",
}


def _autoware(package: str, name: str) -> str:
    root = f"std_msgs/Header header\n{package}/{name.removesuffix('s')}[] objects"
    members = (*_AUTOWARE, _TRACKED_KINEMATICS[package])
    return _SEPARATOR.join((root, *(each.format(p=package) for each in members), *_COMMON))


OURS: Final = {
    DETECTIONS: _SEPARATOR.join((*_VISION, *_COMMON)),
    **{
        f"{package}/{name}": _autoware(package, name)
        for package in AUTOWARE_PACKAGES
        for name in AUTOWARE_TYPES
    },
}
"""Type to its published definition of ROS 2, for logs whose schema is written in IDL or missing."""
