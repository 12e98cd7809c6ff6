"""Messages of boxes as other programs write them, by libraries that the reader does not use."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP_FILE
from mcap_ros1._vendor.genpy import Time
from mcap_ros1._vendor.genpy.dynamic import generate_dynamic
from mcap_ros2._dynamic import serialize_dynamic

from workers.ingest.boxes.kinds import AUTOWARE_PACKAGES, DETECTIONS, OURS
from workers.ingest.boxes.stated import AUTOWARE_CLASSES

NS: Final = 1_000_000_000


@dataclass(frozen=True)
class Box:
    """One box to be written: yaw about z, velocity along the axes of the frame."""

    centre_m: tuple[float, float, float]
    size_m: tuple[float, float, float] = (4.5, 1.9, 1.6)
    yaw_rad: float = 0.0
    velocity_m_per_s: tuple[float, float, float] | None = None
    score: float = 0.9
    class_name: str = "car"
    track_id: str = ""


@dataclass(frozen=True)
class Written:
    """A message, and what its channel says."""

    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes
    data: bytes


def quaternion(yaw_rad: float) -> dict[str, float]:
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw_rad / 2)), "w": float(np.cos(yaw_rad / 2))}


def xyz(values: Sequence[float]) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))


def stamp(stamp_ns: int) -> dict[str, int]:
    return {"sec": stamp_ns // NS, "nanosec": stamp_ns % NS}


def header(stamp_ns: int, frame_id: str) -> dict[str, Any]:
    return {"stamp": stamp(stamp_ns), "frame_id": frame_id}


COVARIANCE: Final = [0.0] * 36


def detections(boxes: Sequence[Box], *, stamp_ns: int, frame_id: str) -> Written:
    """vision_msgs/Detection3DArray of ROS 2 Humble: an id at the detection, no velocity."""
    return ros2(
        "vision_msgs/msg/Detection3DArray",
        OURS[DETECTIONS],
        {
            "header": header(stamp_ns, frame_id),
            "detections": [
                {
                    "header": header(stamp_ns, frame_id),
                    "results": [
                        {
                            "hypothesis": {"class_id": box.class_name, "score": box.score},
                            "pose": {"pose": _pose(box), "covariance": COVARIANCE},
                        }
                    ],
                    "bbox": {"center": _pose(box), "size": xyz(box.size_m)},
                    "id": box.track_id,
                }
                for box in boxes
            ],
        },
    )


def autoware(
    boxes: Sequence[Box],
    *,
    stamp_ns: int,
    frame_id: str,
    name: str = "TrackedObjects",
    package: str = AUTOWARE_PACKAGES[0],
) -> Written:
    """One of Autoware's messages; its velocity is along the axes of the box."""
    return ros2(
        f"{package}/msg/{name}",
        OURS[f"{package}/{name}"],
        {
            "header": header(stamp_ns, frame_id),
            "objects": [_autoware_object(box, name) for box in boxes],
        },
    )


def published(boxes: Sequence[Box], *, stamp_ns: int, frame_id: str) -> Written:
    """The JSON message of `schemas/boxes.v1.schema.json`."""
    message = {
        "stamp_ns": stamp_ns,
        "frame_id": frame_id,
        "boxes": [
            {
                "centre_m": box.centre_m,
                "size_m": box.size_m,
                "yaw_rad": box.yaw_rad,
                "velocity_m_per_s": box.velocity_m_per_s,
                "class_name": box.class_name,
                "score": box.score,
                "track_id": box.track_id,
            }
            for box in boxes
        ],
    }
    data = json.dumps(message).encode()
    return Written("json", "counterpoint.boxes.v1", "jsonschema", b"{}", data)


def scene_json(boxes: Sequence[Box], *, stamp_ns: int, frame_id: str) -> Written:
    """A foxglove.SceneUpdate in JSON: class, score and velocity in the metadata."""
    entities = [
        {
            "timestamp": {"sec": stamp_ns // NS, "nsec": stamp_ns % NS},
            "frame_id": frame_id,
            "id": box.track_id,
            "metadata": [{"key": key, "value": value} for key, value in _told(box).items()],
            "cubes": [
                {
                    "pose": _pose(box),
                    "size": xyz(box.size_m),
                    "color": {"r": 1, "g": 0, "b": 0, "a": 1},
                }
            ],
        }
        for box in boxes
    ]
    data = json.dumps({"deletions": [], "entities": entities}).encode()
    return Written("json", "foxglove.SceneUpdate", "jsonschema", b"{}", data)


def scene_protobuf(boxes: Sequence[Box], *, stamp_ns: int, frame_id: str) -> Written:
    """The same in protobuf, with the published numbers of its fields."""
    timestamp_file = FileDescriptorProto.FromString(TIMESTAMP_FILE.serialized_pb)
    files = FileDescriptorSet(file=[timestamp_file, _scene_file()])
    pool = DescriptorPool()
    for file in files.file:
        pool.Add(file)
    message: Any = GetMessageClass(pool.FindMessageTypeByName("foxglove.SceneUpdate"))()
    for box in boxes:
        entity = message.entities.add(frame_id=frame_id, id=box.track_id)
        entity.timestamp.seconds, entity.timestamp.nanos = divmod(stamp_ns, NS)
        for key, value in _told(box).items():
            entity.metadata.add(key=key, value=value)
        cube = entity.cubes.add()
        for name, part in _pose(box).items():
            for axis, number in part.items():
                setattr(getattr(cube.pose, name), axis, number)
        cube.size.x, cube.size.y, cube.size.z = box.size_m
    schema = files.SerializeToString()
    return Written(
        "protobuf", "foxglove.SceneUpdate", "protobuf", schema, message.SerializeToString()
    )


def ros1_detections(boxes: Sequence[Box], *, stamp_ns: int, frame_id: str) -> Written:
    """vision_msgs/Detection3DArray of ROS 1 Noetic: numbered classes, a cloud in each detection."""
    types = generate_dynamic("vision_msgs/Detection3DArray", ROS1_DETECTIONS)  # type: ignore[no-untyped-call]
    message = types["vision_msgs/Detection3DArray"]()
    message.header.stamp = Time(*divmod(stamp_ns, NS))  # type: ignore[no-untyped-call]
    message.header.frame_id = frame_id
    for box in boxes:
        each: Any = types["vision_msgs/Detection3D"]()
        each.header = message.header
        result = types["vision_msgs/ObjectHypothesisWithPose"]()
        result.id, result.score = AUTOWARE_CLASSES.index(box.class_name), box.score
        each.results.append(result)
        centre, turn = each.bbox.center.position, quaternion(box.yaw_rad)
        centre.x, centre.y, centre.z = box.centre_m
        for axis, part in turn.items():
            setattr(each.bbox.center.orientation, axis, part)
        each.bbox.size.x, each.bbox.size.y, each.bbox.size.z = box.size_m
        each.source_cloud.data = b"abc"
        message.detections.append(each)
    out = BytesIO()
    message.serialize(out)
    return Written(
        "ros1", "vision_msgs/Detection3DArray", "ros1msg", ROS1_DETECTIONS.encode(), out.getvalue()
    )


def ros2(name: str, text: str, message: Mapping[str, Any]) -> Written:
    """Any ROS 2 message, by the published encoder."""
    data = serialize_dynamic(name, text)[name](message)
    return Written("cdr", name, "ros2msg", text.encode(), data)


def _pose(box: Box) -> dict[str, dict[str, float]]:
    return {"position": xyz(box.centre_m), "orientation": quaternion(box.yaw_rad)}


def _told(box: Box) -> dict[str, str]:
    told = {"class": box.class_name, "score": f"{box.score}"}
    if box.velocity_m_per_s is not None:
        told |= {
            f"v{axis}": f"{value}" for axis, value in zip("xyz", box.velocity_m_per_s, strict=True)
        }
    return told


def _autoware_object(box: Box, name: str) -> dict[str, Any]:
    known = box.velocity_m_per_s is not None
    x, y, z = box.velocity_m_per_s or (0.0, 0.0, 0.0)
    cos, sin = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    along = xyz((x * cos + y * sin, y * cos - x * sin, z))
    nothing = xyz((0, 0, 0))
    pose = {"pose": _pose(box), "covariance": COVARIANCE}
    twist = {"twist": {"linear": along, "angular": nothing}, "covariance": COVARIANCE}
    accel = {"accel": {"linear": nothing, "angular": nothing}, "covariance": COVARIANCE}
    kinematics: dict[str, Any] = {"pose_with_covariance": pose, "twist_with_covariance": twist}
    if name == "DetectedObjects":
        kinematics |= {
            "has_position_covariance": False,
            "orientation_availability": 2,
            "has_twist": known,
            "has_twist_covariance": False,
        }
    elif name == "TrackedObjects":
        kinematics |= {
            "acceleration_with_covariance": accel,
            "orientation_availability": 2,
            "is_stationary": False,
        }
    else:
        path = {
            "path": [_pose(box)] * 3,
            "time_step": {"sec": 0, "nanosec": 500_000_000},
            "confidence": 1.0,
        }
        kinematics = {
            "initial_pose_with_covariance": pose,
            "initial_twist_with_covariance": twist,
            "initial_acceleration_with_covariance": accel,
            "predicted_paths": [path, path],
        }
    uuid = list(box.track_id.encode().ljust(16, b"\0")[:16])
    return {
        "object_id": {"uuid": uuid},
        "existence_probability": box.score,
        "classification": [
            {"label": AUTOWARE_CLASSES.index(box.class_name), "probability": 0.9},
            {"label": 0, "probability": 0.1},
        ],
        "kinematics": kinematics,
        "shape": {
            "type": 0,
            "footprint": {"points": [xyz((1, 2, 3))]},
            "dimensions": xyz(box.size_m),
        },
    }


def _scene_file() -> FileDescriptorProto:
    file = FileDescriptorProto(
        name="foxglove/SceneUpdate.proto", package="foxglove", syntax="proto3"
    )
    file.dependency.append(TIMESTAMP_FILE.name)
    numbers = {"double": 1, "string": 9}
    types: dict[str, tuple[tuple[str, int, str, int], ...]] = {
        "Vector3": (("x", 1, "double", 1), ("y", 2, "double", 1), ("z", 3, "double", 1)),
        "Quaternion": tuple(
            (axis, number, "double", 1) for number, axis in enumerate("xyzw", start=1)
        ),
        "Pose": (("position", 1, "Vector3", 1), ("orientation", 2, "Quaternion", 1)),
        "KeyValuePair": (("key", 1, "string", 1), ("value", 2, "string", 1)),
        "CubePrimitive": (("pose", 1, "Pose", 1), ("size", 2, "Vector3", 1)),
        "SceneEntity": (
            ("timestamp", 1, ".google.protobuf.Timestamp", 1),
            ("frame_id", 2, "string", 1),
            ("id", 3, "string", 1),
            ("metadata", 6, "KeyValuePair", 3),
            ("cubes", 8, "CubePrimitive", 3),
        ),
        "SceneUpdate": (("entities", 2, "SceneEntity", 3),),
    }
    for type_name, members in types.items():
        message = file.message_type.add(name=type_name)
        for name, number, kind, label in members:
            field = message.field.add(
                name=name, number=number, type=numbers.get(kind, 11), label=label
            )
            if kind not in numbers:
                field.type_name = kind if kind.startswith(".") else f".foxglove.{kind}"
    return file


_LINE: Final = "\n" + "=" * 80 + "\n"
ROS1_DETECTIONS: Final = _LINE.join(
    (
        "Header header\n\n# A list of the detected proposals.\nDetection3D[] detections",
        "MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id",
        "MSG: vision_msgs/Detection3D\nHeader header\nObjectHypothesisWithPose[] results\n"
        "BoundingBox3D bbox\nsensor_msgs/PointCloud2 source_cloud",
        "MSG: vision_msgs/ObjectHypothesisWithPose\nint64 id\nfloat64 score\n"
        "geometry_msgs/PoseWithCovariance pose",
        "MSG: geometry_msgs/PoseWithCovariance\nPose pose\nfloat64[36] covariance",
        "MSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation",
        "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z",
        "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
        "MSG: vision_msgs/BoundingBox3D\ngeometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
        "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z",
        "MSG: sensor_msgs/PointCloud2\nHeader header\nuint32 height\nuint32 width\n"
        "PointField[] fields\nbool is_bigendian\nuint32 point_step\nuint32 row_step\n"
        "uint8[] data\nbool is_dense",
        "MSG: sensor_msgs/PointField\nuint8 INT8=1\nuint8 FLOAT32 = 7\nstring name\n"
        "uint32 offset\nuint8 datatype\nuint32 count",
    )
)
