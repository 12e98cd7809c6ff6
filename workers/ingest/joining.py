"""Joining: the clouds of further lidars become points of the main lidar's frames."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.frame import JoinedLidar, LidarFrame, RecordedClass, RecordedLabels
from schemas.mining import MiningSettings
from schemas.work import Channel, FurtherLidar, Shard
from workers.errors import CloudUnreadableError
from workers.ingest.frames import frame_from_cloud
from workers.ingest.message_rate import MessageRate
from workers.ingest.messages import MAX_TIME_NS, RawMessage
from workers.ingest.pointcloud import DecodedCloud, decode_cloud
from workers.ingest.recorded_labels import LabelPairing, recorded_labels
from workers.points.se3 import transform

MAX_HELD: Final = 12
"""Frames of the main lidar that wait for a further one: labels of clouds come ten clouds later."""

NO_ANSWER: Final = 65_535
"""Class of points without an answer, unless the model uses it."""

Record = Callable[[str], None]
"""Records what is wrong with the message that is being read."""


class FurtherReader:
    """Frames of one further lidar, from the messages of its topics.

    Args:
        shard: Window and log.
        lidar: The lidar, as planned.
        settings: The meaning of stamps.
        record: Called for every message that cannot be read.
    """

    def __init__(
        self, shard: Shard, lidar: FurtherLidar, settings: MiningSettings, record: Record
    ) -> None:
        self.lidar = lidar
        self.silent = 0
        self._shard, self._settings, self._record = shard, settings, record
        self._rate = MessageRate(by_log_time=False)
        self._frames: deque[LidarFrame] = deque()
        source = lidar.recorded
        self._pairing: LabelPairing[tuple[DecodedCloud, int]] | None = (
            None if source is None or source.channel is None else LabelPairing(source)
        )

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of its clouds and, where they have a topic of their own, of their labels."""
        source = self.lidar.recorded
        labels = None if source is None else source.channel
        return (self.lidar.channel,) if labels is None else (self.lidar.channel, labels)

    def add(self, message: RawMessage) -> None:
        """Add a message of one of its channels."""
        try:
            if message.channel is self.lidar.channel:
                self._rate.check_logged(message)
                cloud = decode_cloud(message)
                self._rate.check_taken(cloud, message)
                self._add_cloud(cloud, message.log_time_ns)
            elif self._pairing is not None:
                for (cloud, log_ns), labels in self._pairing.add_labels(decode_cloud(message)):
                    self._add_frame(cloud, log_ns, labels)
        except CloudUnreadableError as error:
            self._record(str(error))

    def end(self) -> None:
        """Take the clouds that still wait for their labels, once no more messages come."""
        for (cloud, log_ns), labels in () if self._pairing is None else self._pairing.rest():
            self._add_frame(cloud, log_ns, labels)

    def is_past(self, stamp_ns: int) -> bool:
        """Return True once the cloud nearest to an instant is known."""
        return bool(self._frames) and self._frames[-1].stamp_ns >= stamp_ns

    def nearest(self, stamp_ns: int) -> LidarFrame | None:
        """Take the frame nearest to an instant, and forget those before it; None too far away."""
        reach_ns = self.lidar.period_ns // 2
        while self._frames and self._frames[0].stamp_ns < stamp_ns - reach_ns:
            self._frames.popleft()
        near = [each for each in self._frames if each.stamp_ns <= stamp_ns + reach_ns]
        return min(near, key=lambda each: abs(each.stamp_ns - stamp_ns), default=None)

    def _add_cloud(self, cloud: DecodedCloud, log_time_ns: int) -> None:
        source = self.lidar.recorded
        if self._pairing is not None:
            for (paired, log_ns), labels in self._pairing.add_cloud(cloud, (cloud, log_time_ns)):
                self._add_frame(paired, log_ns, labels)
            return
        labels = None
        if source is not None:
            try:
                labels = recorded_labels(cloud, source)
            except CloudUnreadableError as error:
                self._record(str(error))
        self._add_frame(cloud, log_time_ns, labels)

    def _add_frame(
        self, cloud: DecodedCloud, log_time_ns: int, labels: RecordedLabels | None
    ) -> None:
        frame = frame_from_cloud(
            replace(cloud, stamp_ns=0) if cloud.stamp_ns > MAX_TIME_NS else cloud,
            log_id=self._shard.log_id,
            log_time_ns=log_time_ns,
            previous_stamp_ns=self._frames[-1].stamp_ns if self._frames else None,
            intensity_scale=self.lidar.intensity_scale,
            stamp_at=self._settings.stamp_at,
            compensated=self._settings.compensated,
            recorded=labels,
        )
        self._frames.append(frame)


class Joiner:
    """Joins to each frame of the main lidar the nearest cloud of every further one.

    Args:
        shard: Window, log and further lidars.
        settings: The meaning of stamps.
        record: Called for every message that cannot be read.
    """

    def __init__(self, shard: Shard, settings: MiningSettings, record: Record) -> None:
        self._shard = shard
        self._readers = [FurtherReader(shard, each, settings, record) for each in shard.further]
        self._by_channel = {id(each): one for one in self._readers for each in one.channels}
        self._scored = 0

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels of the clouds and labels of all further lidars."""
        return tuple(each for reader in self._readers for each in reader.channels)

    def takes(self, channel: Channel) -> bool:
        """Return True for a channel of a further lidar."""
        return id(channel) in self._by_channel

    def add(self, message: RawMessage) -> None:
        """Add a message of such a channel."""
        self._by_channel[id(message.channel)].add(message)

    def joined(self, frames: Iterator[tuple[LidarFrame, int]]) -> Iterator[tuple[LidarFrame, int]]:
        """Yield joined frames with their log times, in order.

        Args:
            frames: Frames of the main lidar; drawing them adds the messages between them.
        """
        held: deque[tuple[LidarFrame, int]] = deque()
        for each in frames:
            held.append(each)
            while held and (len(held) > MAX_HELD or self._is_past(held[0][0])):
                yield self._first(held)
        for reader in self._readers:
            reader.end()
        while held:
            yield self._first(held)

    def sentences(self) -> Iterator[str]:
        """Say of how many scored frames each lidar has no cloud."""
        for reader in self._readers:
            if reader.silent:
                yield (
                    f"the lidar {reader.lidar.channel.topic} has no cloud within "
                    f"{reader.lidar.period_ns / 2e6:.0f} ms of {reader.silent} of {self._scored} "
                    "frames: they were mined without it"
                )

    def _is_past(self, frame: LidarFrame) -> bool:
        return all(reader.is_past(frame.stamp_ns) for reader in self._readers)

    def _first(self, held: deque[tuple[LidarFrame, int]]) -> tuple[LidarFrame, int]:
        frame, log_time_ns = held.popleft()
        scores = self._shard.start_ns <= frame.stamp_ns < self._shard.end_ns
        self._scored += scores
        found = [reader.nearest(frame.stamp_ns) for reader in self._readers]
        for reader, cloud in zip(self._readers, found, strict=True):
            reader.silent += scores and cloud is None
        pairs = zip(self._shard.further, found, strict=True)
        return joined_frame(frame, list(pairs)), log_time_ns


def joined_frame(
    main: LidarFrame, further: Sequence[tuple[FurtherLidar, LidarFrame | None]]
) -> LidarFrame:
    """Append the points of further lidars to a frame, in the space of its lidar.

    Times of points count from the stamp of the main frame. What the car drove between two stamps
    is not known yet; it is put in once the poses are (`workers.lidar.several_lidars`).

    Args:
        main: Frame of the main lidar.
        further: Each further lidar with its frame; None where it is silent.
    """
    lidars, parts = [], [main]
    for lidar, frame in further:
        placed = np.array(lidar.main_from_lidar).reshape(4, 4)
        here = frame if frame is not None and len(frame) else None
        if here is not None:
            points_m = transform(placed, here.points_m)
            points_m[~here.valid_mask] = 0.0
            later_ns = np.int32(here.stamp_ns - main.stamp_ns)
            parts.append(replace(here, points_m=points_m, offset_ns=here.offset_ns + later_ns))
        lidars.append(
            JoinedLidar(
                topic=lidar.channel.topic,
                points=0 if here is None else len(here),
                stamp_ns=0 if here is None else here.stamp_ns,
                main_from_lidar=placed,
                has_point_time=here is not None and here.has_point_time,
            )
        )
    return replace(
        main,
        points_m=np.concatenate([each.points_m for each in parts]),
        intensity=np.concatenate([each.intensity for each in parts]),
        offset_ns=np.concatenate([each.offset_ns for each in parts]),
        ring=np.concatenate([each.ring for each in parts]),
        valid_mask=np.concatenate([each.valid_mask for each in parts]),
        recorded=_joined_labels(parts),
        joined=tuple(lidars),
    )


def _joined_labels(parts: Sequence[LidarFrame]) -> RecordedLabels | None:
    """Join the labels of all parts; points of a part without labels have no answer."""
    said = [part.recorded for part in parts if part.recorded is not None]
    if not said:
        return None
    classes: dict[int, RecordedClass] = {}
    for each in said:
        classes.update(each.classes)
    nothing = _unused_class(classes)
    has_motion = any(each.motion is not None for each in said)
    has_confidence = any(each.confidence is not None for each in said)
    class_id, motion, confidence = [], [], []
    for part in parts:
        n, labels = len(part), part.recorded
        class_id.append(np.full(n, nothing, np.uint16) if labels is None else labels.class_id)
        motion.append(_or(None if labels is None else labels.motion, n, np.uint8(0)))
        sure = np.float32(0.0 if labels is None else 1.0)
        confidence.append(_or(None if labels is None else labels.confidence, n, sure))
    return RecordedLabels(
        class_id=np.concatenate(class_id),
        motion=np.concatenate(motion) if has_motion else None,
        confidence=np.concatenate(confidence) if has_confidence else None,
        classes=classes,
    )


def _or(values: NDArray[Any] | None, points: int, otherwise: np.generic) -> NDArray[Any]:
    return np.full(points, otherwise) if values is None else values


def _unused_class(classes: Mapping[int, RecordedClass]) -> int:
    """Return a class id without a meaning, so that its points are unknown."""
    return next((each for each in range(NO_ANSWER, -1, -1) if each not in classes), NO_ANSWER)
