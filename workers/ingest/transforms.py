"""Transform tree: a log's coordinate systems, and the transform between any two of them."""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from schemas.arrays import Transform
from schemas.work import Channel
from workers.ingest.decoding import MessageUnreadableError, can_decode, decode_message, ros_type
from workers.ingest.messages import RawMessage
from workers.points.se3 import inverse

ROS_TRANSFORMS: Final = "tf2_msgs/TFMessage"
FOXGLOVE_TRANSFORMS: Final = "foxglove.FrameTransforms"
FOXGLOVE_TRANSFORM: Final = "foxglove.FrameTransform"


def has_transforms(channel: Channel) -> bool:
    """Return True for a channel of transforms that can be read here."""
    return any(
        can_decode(channel, ros=ROS_TRANSFORMS, foxglove=foxglove)
        for foxglove in (FOXGLOVE_TRANSFORMS, FOXGLOVE_TRANSFORM)
    )


def is_static(channel: Channel) -> bool:
    """Return True for a topic of constant transforms, by the name that ROS gives it."""
    return channel.topic.strip("/").endswith("tf_static")


@dataclass(frozen=True, slots=True, eq=False)
class StatedTransform:
    """Pose of one space in another."""

    parent: str
    child: str
    parent_from_child: Transform


class TransformTree:
    """Transforms between spaces, by the log's own names."""

    def __init__(self) -> None:
        """Begin without spaces."""
        self._to_from: dict[str, dict[str, Transform]] = {}

    def add(self, *, parent: str, child: str, parent_from_child: Transform) -> None:
        """Add the pose of a space in another; a later one replaces an earlier one."""
        parent, child = parent.strip("/"), child.strip("/")
        self._to_from.setdefault(parent, {})[child] = parent_from_child
        self._to_from.setdefault(child, {})[parent] = inverse(parent_from_child)

    def add_stated(self, stated: Iterable["StatedTransform"]) -> None:
        """Add the transforms of messages."""
        for each in stated:
            self.add(parent=each.parent, child=each.child, parent_from_child=each.parent_from_child)

    def find(self, *, to: str, source: str) -> Transform | None:
        """Chain the transforms that map points of one space to another.

        Returns:
            (4, 4) `to_from_source`; None where the log does not connect them.
        """
        to, source = to.strip("/"), source.strip("/")
        seen: dict[str, Transform] = {to: np.eye(4)}
        waiting = deque([to])
        while waiting:
            space = waiting.popleft()
            if space == source:
                return seen[space]
            for other, space_from_other in self._to_from.get(space, {}).items():
                if other not in seen:
                    seen[other] = seen[space] @ space_from_other
                    waiting.append(other)
        return None


def rigid(translation_m: tuple[float, ...], quaternion_xyzw: tuple[float, ...]) -> Transform:
    """Build a transform; a quaternion of zeros, which was left unset, is no rotation.

    Raises:
        ValueError: If a number is not finite.
    """
    x, y, z, w = quaternion_xyzw
    norm = float(np.linalg.norm(quaternion_xyzw))
    if not np.isfinite([*translation_m, norm]).all():
        raise ValueError("transform with numbers that are not finite")
    x, y, z, w = (x / norm, y / norm, z / norm, w / norm) if norm else (0.0, 0.0, 0.0, 1.0)
    to_from: Transform = np.eye(4)
    to_from[:3, :3] = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    to_from[:3, 3] = translation_m
    return to_from


def member(message: Any, name: str) -> Any:
    """Read a field of a decoded message, which is a dict if it was JSON."""
    return message[name] if isinstance(message, dict) else getattr(message, name)


def stated_transforms(message: RawMessage) -> list[StatedTransform]:
    """Decode the transforms in a message.

    Raises:
        MessageUnreadableError: If it is no such message.
    """
    decoded = decode_message(message)
    try:
        return list(_stated(message.channel, decoded))
    except (KeyError, AttributeError, TypeError, ValueError, OverflowError) as error:
        raise MessageUnreadableError(
            f"cannot read {message.channel.schema_name}: {type(error).__name__}: {error} "
            f"({message.channel.topic}, logged at {message.log_time_ns})"
        ) from error


def _stated(channel: Channel, message: Any) -> Iterator[StatedTransform]:
    if ros_type(channel) == ROS_TRANSFORMS:
        for each in message.transforms:
            placed = _rigid_of(each.transform)
            yield StatedTransform(each.header.frame_id, each.child_frame_id, placed)
        return
    single = channel.schema_name == FOXGLOVE_TRANSFORM
    for each in [message] if single else member(message, "transforms"):
        parent, child = member(each, "parent_frame_id"), member(each, "child_frame_id")
        yield StatedTransform(str(parent), str(child), _rigid_of(each))


def _rigid_of(message: Any) -> Transform:
    translation, rotation = member(message, "translation"), member(message, "rotation")
    return rigid(
        tuple(float(member(translation, name)) for name in "xyz"),
        tuple(float(member(rotation, name)) for name in "xyzw"),
    )
