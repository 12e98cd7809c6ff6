"""Spaces over time: poses of a log's coordinate systems, interpolated, for the boxes of a model."""

from bisect import bisect_left
from collections import deque
from collections.abc import Iterable
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from schemas.arrays import NS_PER_S, Transform
from schemas.recorded_source import StatedPose
from schemas.work import Channel
from workers.ingest.camera_messages import frame_and_stamp
from workers.ingest.decoding import MessageUnreadableError, can_decode, decode_message, ros_type
from workers.ingest.messages import RawMessage
from workers.ingest.transforms import (
    TransformTree,
    has_transforms,
    is_static,
    member,
    rigid,
    stated_transforms,
)

ODOMETRY: Final = "nav_msgs/Odometry"

KEPT_NS: Final = 5 * NS_PER_S
"""Time for which poses are kept, nanoseconds; boxes come at most a second after their cloud."""

HELD_NS: Final = NS_PER_S // 4
"""Time beyond the first and the last pose for which they count, nanoseconds."""

MAX_GAP_NS: Final = NS_PER_S
"""Largest gap between two poses that is interpolated, nanoseconds."""

MAX_EDGES: Final = 1_024
"""Pairs of spaces; a car has some dozens."""


def places_boxes(channel: Channel) -> bool:
    """Return True for a channel of transforms over time, or of recorded poses."""
    return (has_transforms(channel) and not is_static(channel)) or can_decode(
        channel, ros=ODOMETRY, foxglove=""
    )


class Spaces:
    """Poses between spaces over the last seconds of a log.

    Transforms (`tf`) win over recorded poses: a pose of odometry joins two spaces only where no
    transform does.

    Args:
        static: Transforms that never change.
    """

    def __init__(self, static: Iterable[StatedPose] = ()) -> None:
        self._static = tuple(
            (each.parent, each.child, np.array(each.parent_from_child).reshape(4, 4))
            for each in static
        )
        self._over_time: dict[tuple[str, str], deque[tuple[int, Transform]]] = {}
        self._odometry: dict[tuple[str, str], deque[tuple[int, Transform]]] = {}

    def add(self, message: RawMessage) -> None:
        """Add the transforms or the pose of a message.

        Raises:
            MessageUnreadableError: If it cannot be decoded.
        """
        if ros_type(message.channel) == ODOMETRY:
            self._add_pose(message)
            return
        stamps = _stamps_ns(message)
        for number, each in enumerate(stated_transforms(message)):
            stamp_ns = stamps[number] if number < len(stamps) else 0
            self._keep(
                self._over_time,
                (each.parent.strip("/"), each.child.strip("/")),
                stamp_ns or message.log_time_ns,
                each.parent_from_child,
            )

    def find(self, *, to: str, source: str, time_ns: int) -> Transform | None:
        """Chain the transforms that map points of one space to another at an instant.

        Returns:
            (4, 4) `to_from_source`; None where the log does not connect them at that time.
        """
        if to.strip("/") == source.strip("/"):
            return np.eye(4)
        found = self._tree(time_ns, poses=False).find(to=to, source=source)
        return (
            found
            if found is not None
            else self._tree(time_ns, poses=True).find(to=to, source=source)
        )

    def knows(self, space: str) -> bool:
        """Return True for a space that any transform or pose names."""
        named = {name for parent, child, _ in self._static for name in (parent, child)}
        for pair in (*self._over_time, *self._odometry):
            named.update(pair)
        return space.strip("/") in {name.strip("/") for name in named}

    def _tree(self, time_ns: int, *, poses: bool) -> TransformTree:
        tree = TransformTree()
        for parent, child, placed in self._static:
            tree.add(parent=parent, child=child, parent_from_child=placed)
        edges = {**self._odometry, **self._over_time} if poses else self._over_time
        for (parent, child), samples in edges.items():
            pose = _at(samples, time_ns)
            if pose is not None:
                tree.add(parent=parent, child=child, parent_from_child=pose)
        return tree

    def _add_pose(self, message: RawMessage) -> None:
        decoded = decode_message(message)
        try:
            parent, stamp_ns = frame_and_stamp(decoded)
            pose, child = decoded.pose.pose, str(decoded.child_frame_id)
            placed = rigid(
                tuple(float(member(pose.position, axis)) for axis in "xyz"),
                tuple(float(member(pose.orientation, axis)) for axis in "xyzw"),
            )
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            raise MessageUnreadableError(
                f"cannot read the pose of {message.channel.topic}: {error} "
                f"(logged at {message.log_time_ns})"
            ) from error
        if parent and child:
            pair = (parent.strip("/"), child.strip("/"))
            self._keep(self._odometry, pair, stamp_ns or message.log_time_ns, placed)

    def _keep(
        self,
        edges: dict[tuple[str, str], deque[tuple[int, Transform]]],
        pair: tuple[str, str],
        time_ns: int,
        placed: Transform,
    ) -> None:
        if pair not in edges and len(edges) >= MAX_EDGES:
            return
        samples = edges.setdefault(pair, deque())
        if samples and time_ns <= samples[-1][0]:
            return  # repeated, or of an earlier clock
        samples.append((time_ns, placed))
        while samples[-1][0] - samples[0][0] > KEPT_NS:
            samples.popleft()


def _at(samples: deque[tuple[int, Transform]], time_ns: int) -> Transform | None:
    """Interpolate a pose; None too far from any sample."""
    times = [each for each, _ in samples]
    after = bisect_left(times, time_ns)
    if after < len(times) and times[after] == time_ns:
        return samples[after][1]
    if after == 0 or after == len(times):
        nearest = samples[0 if after == 0 else -1]
        return nearest[1] if abs(nearest[0] - time_ns) <= HELD_NS else None
    (start_ns, first), (end_ns, last) = samples[after - 1], samples[after]
    if end_ns - start_ns > MAX_GAP_NS:
        return None
    share = (time_ns - start_ns) / (end_ns - start_ns)
    placed: Transform = np.eye(4)
    rotations = Rotation.from_matrix(np.stack([first[:3, :3], last[:3, :3]]))
    placed[:3, :3] = Slerp([0.0, 1.0], rotations)(share).as_matrix()
    placed[:3, 3] = (1.0 - share) * first[:3, 3] + share * last[:3, 3]
    return placed


def _stamps_ns(message: RawMessage) -> list[int]:
    """Return the stamp of each transform of a message; 0 where it has none."""
    decoded = decode_message(message)
    if hasattr(decoded, "transforms") and ros_type(message.channel).startswith("tf2_msgs/"):
        return [frame_and_stamp(each)[1] for each in decoded.transforms]
    many = (
        decoded.get("transforms")
        if isinstance(decoded, dict)
        else getattr(decoded, "transforms", None)
    )
    return [_stamp_of(each) for each in (many if many is not None else [decoded])]


def _stamp_of(transform: object) -> int:
    stamp = (
        transform.get("timestamp")
        if isinstance(transform, dict)
        else getattr(transform, "timestamp", None)
    )
    if stamp is None:
        return 0
    if isinstance(stamp, dict):
        return int(stamp.get("sec", 0)) * NS_PER_S + int(stamp.get("nsec", 0))
    return int(stamp.seconds) * NS_PER_S + int(stamp.nanos)
