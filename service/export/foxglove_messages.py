"""Overlay of a scene as messages of Foxglove's schemas, in Protobuf.

The classes come from the package `foxglove-schemas-protobuf` of the extra `export`.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, Final

import numpy as np

from schemas.arrays import NS_PER_S
from schemas.excerpt import ExcerptChannel, ExcerptMessage
from schemas.overlay import Overlay
from schemas.score import SceneScore
from service.export.points import LabelledCloud
from service.export.rotation import quaternion_wxyz
from service.pictures.style import colours_of, inks_of

POINTS: Final = "/counterpoint/points"
BOXES: Final = "/counterpoint/boxes"
EVENTS: Final = "/counterpoint/events"
SPACES: Final = "/counterpoint/tf"
ODOM: Final = "counterpoint_odom"
"""Space of the poses by which the scene was mined, a child of the lidar's space.

As a child it adds no second parent to a space of the log's own tree of transforms."""

_POINT: Final = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("alpha", "u1"),
        ("score", "<f4"),
        ("index", "<u4"),
        ("track", "<i2"),
        ("label", "<u2"),
        ("category", "u1"),
    ],
    align=True,
)
"""One point: `index` is its place in the raw message, `category` the code of its outcome."""

_PLACES: Final[Mapping[str, Any]] = _POINT.fields or {}
"""Type and offset of each element."""

_STEPS_PER_M: Final = np.float32(256)
"""Steps of a coordinate in a metre: 4 mm compress well, and the raw cloud has the exact place."""

_TYPES: Final = {"u1": 1, "<u2": 3, "<i2": 4, "<u4": 5, "<f4": 7}
"""Foxglove's numbers of the element types."""

_BOX_ALPHA: Final = 0.35
_MOST_TRACKS: Final = 32_767


@cache
def _classes() -> Mapping[str, Any]:
    from importlib import import_module

    names = (
        *("Event", "FrameTransform", "KeyValuePair", "PointCloud", "PackedElementField"),
        *("SceneUpdate", "SceneEntity", "CubePrimitive", "TextPrimitive", "Color", "Pose"),
    )
    room = "foxglove_schemas_protobuf"
    return {name: getattr(import_module(f"{room}.{name}_pb2"), name) for name in names}


@cache
def _channel(topic: str, name: str) -> ExcerptChannel:
    """Return the channel of a topic of ours: its schema is a set of descriptors, as MCAP asks."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    files: dict[str, Any] = {}

    def add(file: Any) -> None:
        for needed in file.dependencies:
            add(needed)
        files.setdefault(file.name, file)

    add(_classes()[name].DESCRIPTOR.file)
    described = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(described.file.add())
    return ExcerptChannel(
        topic=topic,
        message_encoding="protobuf",
        schema_name=f"foxglove.{name}",
        schema_encoding="protobuf",
        schema_data=described.SerializeToString(),
    )


def point_cloud(cloud: LabelledCloud, overlay: Overlay, *, log_time_ns: int) -> ExcerptMessage:
    """Return the returns of a frame with colours, categories, tracks and scores."""
    made = np.zeros(len(cloud), dtype=_POINT)
    colours = np.zeros((256, 3), dtype=np.uint8)
    for code, colour in colours_of(overlay.task).items():
        colours[code] = colour
    for axis, name in enumerate("xyz"):
        made[name] = np.round(cloud.points_m[:, axis] * _STEPS_PER_M) / _STEPS_PER_M
    for axis, name in enumerate(("red", "green", "blue")):
        made[name] = colours[cloud.category, axis]
    made["alpha"] = 255
    made["score"], made["index"] = cloud.score, cloud.raw_index
    made["track"] = np.minimum(cloud.track, _MOST_TRACKS)
    made["label"], made["category"] = cloud.label, cloud.category
    message = _classes()["PointCloud"](frame_id=cloud.frame_id)
    _set_time(message.timestamp, cloud.stamp_ns)
    _set_pose(message.pose, (0.0, 0.0, 0.0), 0.0)
    message.point_stride = _POINT.itemsize
    for name in _POINT.names or ():
        kind, offset = _PLACES[name][:2]
        message.fields.add(name=name, offset=offset, type=_TYPES[kind.str.replace("|", "")])
    message.data = made.tobytes()
    return _message(POINTS, "PointCloud", message, log_time_ns)


def boxes(
    cloud: LabelledCloud, overlay: Overlay, score: SceneScore, *, until_ns: int, log_time_ns: int
) -> ExcerptMessage:
    """Return the boxes of a frame's contradictions, each valid until the next frame.

    Args:
        cloud: The frame.
        overlay: Overlay of the scene.
        score: Record of the scene.
        until_ns: Stamp of the next frame.
        log_time_ns: Log time of the message.
    """
    tracks = {track.track_id: track for track in score.tracks}
    kinds = {kind.code: kind.name for kind in overlay.task.kinds if not kind.of_witness}
    witness = next((kind.name for kind in overlay.task.kinds if kind.of_witness), "")
    inks = inks_of(overlay.task)
    update = _classes()["SceneUpdate"]()
    for instance in overlay.instances_of(cloud.number).tolist():
        number, code = int(overlay.instance_track[instance]), int(overlay.instance_kind[instance])
        x, y, z, length, width, height, yaw = map(float, overlay.instance_boxes[instance])
        entity = update.entities.add(frame_id=cloud.frame_id, id=f"track-{number}-{instance}")
        _set_time(entity.timestamp, cloud.stamp_ns)
        _set_time(entity.lifetime, max(0, until_ns - cloud.stamp_ns))
        track = tracks.get(number)
        about = {"track_id": str(number), "kind": kinds.get(code, witness)}
        if track is not None:
            about |= {
                "kind": track.kind,
                "class": track.class_name,
                "strength": f"{track.strength:.3f}",
                "wrong": track.attribution.wrong.value if track.attribution else "",
            }
        for key, value in about.items():
            entity.metadata.add(key=key, value=value)
        red, green, blue = (part / 255 for part in inks[code])
        cube = entity.cubes.add()
        _set_pose(cube.pose, (x, y, z), yaw)
        cube.size.x, cube.size.y, cube.size.z = length, width, height
        _set_colour(cube.color, red, green, blue, _BOX_ALPHA)
        if track is not None:
            text = entity.texts.add(billboard=True, font_size=14.0, scale_invariant=True)
            _set_pose(text.pose, (x, y, z + height / 2 + 0.5), 0.0)
            _set_colour(text.color, 1.0, 1.0, 1.0, 1.0)
            text.text = f"{number + 1} {track.class_name or 'object'} {track.strength:.2f}"
    return _message(BOXES, "SceneUpdate", update, log_time_ns)


def pose(cloud: LabelledCloud, *, log_time_ns: int) -> ExcerptMessage:
    """Return the pose of a frame: the odom space as a child of the lidar's."""
    sensor_from_odom = np.asarray(np.linalg.inv(cloud.odom_from_sensor), dtype=np.float64)
    message = _classes()["FrameTransform"](parent_frame_id=cloud.frame_id, child_frame_id=ODOM)
    _set_time(message.timestamp, cloud.stamp_ns)
    x, y, z = map(float, sensor_from_odom[:3, 3])
    message.translation.x, message.translation.y, message.translation.z = x, y, z
    w, x, y, z = quaternion_wxyz(sensor_from_odom[:3, :3])
    message.rotation.w, message.rotation.x = w, x
    message.rotation.y, message.rotation.z = y, z
    return _message(SPACES, "FrameTransform", message, log_time_ns)


def events(
    score: SceneScore, *, facts: Mapping[str, str], log_time_ns: int
) -> Iterator[ExcerptMessage]:
    """Yield an event for the scene, and one for each reason about a track.

    Args:
        score: Record of the scene.
        facts: Content of the scene's event, by name.
        log_time_ns: Log time of the messages.
    """
    yield _event(score.start_ns, score.end_ns, facts, log_time_ns)
    tracks = {track.track_id: track for track in score.tracks}
    for reason in score.reasons:
        track = tracks.get(-1 if reason.track_id is None else reason.track_id)
        if track is None:
            continue
        about = {
            "track_id": str(track.track_id),
            "kind": track.kind,
            "class": track.class_name,
            "strength": f"{track.strength:.3f}",
            "reason": reason.text,
        }
        if track.attribution:
            about["wrong"] = track.attribution.wrong.value
            about["chance"] = f"{track.attribution.chance:.3f}"
        yield _event(track.first_ns, track.last_ns, about, log_time_ns)


def _event(
    start_ns: int, end_ns: int, facts: Mapping[str, str], log_time_ns: int
) -> ExcerptMessage:
    event = _classes()["Event"]()
    _set_time(event.start_time, start_ns)
    _set_time(event.end_time, end_ns)
    for key, value in facts.items():
        event.metadata.add(key=key, value=value)
    return _message(EVENTS, "Event", event, log_time_ns)


def _message(topic: str, name: str, message: Any, log_time_ns: int) -> ExcerptMessage:
    data = message.SerializeToString()
    return ExcerptMessage(_channel(topic, name), log_time_ns, log_time_ns, data)


def _set_time(field: Any, ns: int) -> None:
    field.seconds, field.nanos = divmod(ns, NS_PER_S)


def _set_pose(field: Any, centre_m: tuple[float, float, float], yaw_rad: float) -> None:
    field.position.SetInParent()  # readers expect a position at the origin, too
    field.position.x, field.position.y, field.position.z = centre_m
    field.orientation.w = float(np.cos(yaw_rad / 2))
    field.orientation.z = float(np.sin(yaw_rad / 2))


def _set_colour(field: Any, red: float, green: float, blue: float, alpha: float) -> None:
    field.r, field.g, field.b, field.a = red, green, blue, alpha
