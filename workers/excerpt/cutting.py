"""Excerpts: the messages of a log around one scene, and the scene's frames among them."""

import heapq
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from mcap.opcode import Opcode
from mcap.records import Metadata

from schemas.arrays import NS_PER_S
from schemas.errors import PermanentError
from schemas.excerpt import ExcerptChannel, ExcerptMessage, SceneCloud
from schemas.overlay import Overlay
from schemas.transport.bucket import Bucket
from schemas.work import Channel, ChunkRef, Recording
from workers.errors import ChunkUnreadableError, CloudUnreadableError
from workers.excerpt.further_clouds import FramesMissingError, FurtherClouds
from workers.ingest.chunk import messages_in, open_chunk
from workers.ingest.decoding import ros_type
from workers.ingest.fetch import OpenedChunk, fetch_chunks
from workers.ingest.frames import frame_from_cloud, intensity_scale_of
from workers.ingest.index import IndexedChunk, read_summary
from workers.ingest.log_index import LogIndex, index_recording
from workers.ingest.messages import RawMessage
from workers.ingest.part_reader import PartReader
from workers.ingest.pointcloud import decode_cloud
from workers.ingest.records import RecordMalformedError, parse, walk
from workers.ingest.topic_sampling import sample_end, sample_topics
from workers.ingest.topics import Topic, chunks_of, count_in, topics_of
from workers.ingest.transforms import is_static

MARGIN_NS: Final = NS_PER_S
"""Time before the first and after the last frame that an excerpt also has, nanoseconds.

A player needs transforms and images on both sides of a frame, and a labeller the way of an object.
"""

MAX_METADATA: Final = 64
"""Metadata records of a log that are copied; writers leave a few."""

MAX_METADATA_BYTES: Final = 1024 * 1024
"""Bytes of a metadata record that is copied."""

_TIME_BYTES: Final = 8
"""Bytes of the publish time, which is the last field before a message's payload."""

SPACES: Final = frozenset(
    {
        "tf2_msgs/TFMessage",
        "tf/tfMessage",
        "foxglove.FrameTransform",
        "foxglove.FrameTransforms",
    }
)
CALIBRATIONS: Final = frozenset({"sensor_msgs/CameraInfo", "foxglove.CameraCalibration"})
SENSED: Final = frozenset(
    {
        "sensor_msgs/CompressedImage",
        "sensor_msgs/Image",
        "foxglove_msgs/CompressedVideo",
        "foxglove.CompressedImage",
        "foxglove.CompressedVideo",
        "foxglove.RawImage",
        "nav_msgs/Odometry",
        "geometry_msgs/PoseStamped",
        "geometry_msgs/PoseWithCovarianceStamped",
        "geometry_msgs/TwistStamped",
        "geometry_msgs/TwistWithCovarianceStamped",
        "foxglove.Odometry",
        "foxglove.PoseInFrame",
        "sensor_msgs/Imu",
        "sensor_msgs/NavSatFix",
        "foxglove.LocationFix",
    }
)
"""Types of messages that are copied in addition to the lidar, by their names without `msg/`."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenedLog:
    """A log whose index is known.

    Attributes:
        index: Its contents.
        topics: Its topics.
    """

    index: LogIndex
    topics: tuple[Topic, ...]


def open_log(bucket: Bucket, recording: Recording) -> OpenedLog:
    """Index a log.

    Raises:
        NotMcapError: If no part is an MCAP file.
        ObjectChangedError: If a part is no longer the listed one.
    """
    index = index_recording(bucket, recording)
    return OpenedLog(index, topics_of(index.parts))


class CutExcerpt:
    """The messages around one scene, read once for each call."""

    def __init__(self, log: OpenedLog, overlay: Overlay, *, lidar_topic: str) -> None:
        """Find the scene in a log.

        Args:
            log: The log.
            overlay: Overlay of the scene.
            lidar_topic: Topic of the scene's lidar.

        Raises:
            FramesMissingError: If the log has no cloud of that topic.
        """
        lidars = [each for each in log.topics if each.channel.topic == lidar_topic]
        sample = sample_topics(log.index, lidars, []).get(lidar_topic)
        if sample is None:
            raise FramesMissingError(
                f"the log {log.index.recording.log_id} has no cloud of {lidar_topic} that can be "
                "read: the scene was mined from another file of this name"
            )
        if sample.clocks_differ:
            sample_end(log.index, sample)
        self._log, self._overlay, self._sample = log, overlay, sample
        self._further = FurtherClouds(log.index, log.topics, overlay)
        self._scale = intensity_scale_of([*sample.clouds, *sample.later_clouds])
        self._numbers = {int(stamp): i for i, stamp in enumerate(overlay.stamps_ns)}
        self._channels = _recorded_channels(log.index)

    @property
    def metadata(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        """Yield the metadata records of the log, such as its licence."""
        for reader in self._log.index.readers:
            yield from _metadata_of(reader)

    def messages(self) -> Iterator[ExcerptMessage]:
        """Yield lidar, transforms, motion and cameras around the scene, in the order of log times.

        Transforms and calibrations that were recorded once, before the excerpt, come first, with
        the log time of its beginning.

        Raises:
            FramesMissingError: If the log does not contain all frames of the scene.
        """
        lidar = self._sample.topic
        lidars = {lidar.channel.topic, *(each.topic for each in self._overlay.lidars)}
        wanted = [
            each
            for each in self._log.topics
            if each.channel.topic in lidars or _is_copied(each.channel)
        ]
        self._read_further()
        start_ns, end_ns = self._window()
        for message in self._latched(wanted, start_ns, end_ns):
            yield replace(message, log_time_ns=start_ns)
        yield from self._with_clouds(self._within(wanted, start_ns, end_ns))

    def clouds(self) -> Iterator[SceneCloud]:
        """Yield the frames of the scene in order.

        Raises:
            FramesMissingError: If the log does not contain all of them.
        """
        self._read_further()
        start_ns, end_ns = self._window(margin_ns=0)
        found = self._with_clouds(self._within([self._sample.topic], start_ns, end_ns))
        for message in found:
            if message.cloud is not None:
                yield message.cloud

    def _window(self, margin_ns: int = MARGIN_NS) -> tuple[int, int]:
        """Return the first and the last log time of the excerpt."""
        delays = self._sample.bounds
        first_ns, last_ns = int(self._overlay.stamps_ns[0]), int(self._overlay.stamps_ns[-1])
        return max(0, first_ns + delays.least_ns - margin_ns), last_ns + delays.most_ns + margin_ns

    def _read_further(self) -> None:
        """Read the clouds of further lidars around the scene; nothing where one was mined."""
        if self._overlay.lidars:
            found = self._within(self._further.topics, *self._window())
            self._further.read((each.channel.topic, each.log_time_ns, each.data) for each in found)

    def _with_clouds(self, messages: Iterator[ExcerptMessage]) -> Iterator[ExcerptMessage]:
        missing = set(self._numbers.values())
        lidar = self._sample.topic.channel
        for message in messages:
            if message.channel.topic == lidar.topic and missing:
                cloud = self._cloud(RawMessage(lidar, message.log_time_ns, message.data))
                if cloud is not None and cloud.number in missing:
                    missing.remove(cloud.number)
                    message = replace(message, cloud=cloud)
            yield message
        if missing:
            raise FramesMissingError(
                f"the log {self._log.index.recording.log_id} no longer has {len(missing)} of "
                f"{len(self._overlay)} frames of the scene: it was replaced, or is damaged there"
            )

    def _cloud(self, message: RawMessage) -> SceneCloud | None:
        """Decode a frame of the scene, by its stamp, else by its log time; None for others."""
        try:
            cloud = decode_cloud(message)
        except CloudUnreadableError:
            return None
        stamp_ns = cloud.stamp_ns if cloud.stamp_ns in self._numbers else message.log_time_ns
        number = self._numbers.get(stamp_ns)
        if number is None:
            return None
        mined = int(self._overlay.main_points[number])
        if len(cloud) != mined:
            raise FramesMissingError(
                f"the frame of {stamp_ns} ns has {len(cloud)} points in the log and "
                f"{mined} in the overlay: the log was replaced "
                f"({self._log.index.recording.log_id})"
            )
        frame = frame_from_cloud(
            replace(cloud, stamp_ns=stamp_ns),
            log_id=self._log.index.recording.log_id,
            log_time_ns=message.log_time_ns,
            previous_stamp_ns=None,
            intensity_scale=self._scale,
            stamp_at="start",
        )
        frame = self._further.joined(frame, number)
        return SceneCloud(number=number, frame=frame, frame_id=cloud.frame_id)

    def _within(
        self, topics: Sequence[Topic], start_ns: int, end_ns: int
    ) -> Iterator[ExcerptMessage]:
        """Yield the messages with log times from start to end, in their order."""
        found = {
            (each.ref.part, each.ref.offset): each.ref
            for topic in topics
            for each in chunks_of(topic.channel, self._log.index.parts)
            if each.ref.start_ns <= end_ns and each.ref.end_ns >= start_ns
        }
        refs = sorted(found.values(), key=lambda ref: (ref.start_ns, ref.part, ref.offset))
        ids = _ids_of(topics)
        waiting: list[tuple[int, int, ExcerptMessage]] = []
        arrived = 0
        for number, opened in enumerate(fetch_chunks(self._log.index.readers, refs)):
            for message in self._copied(opened, ids):
                if start_ns <= message.log_time_ns <= end_ns:
                    heapq.heappush(waiting, (message.log_time_ns, arrived, message))
                    arrived += 1
            next_ns = refs[number + 1].start_ns if number + 1 < len(refs) else None
            while waiting and (next_ns is None or waiting[0][0] <= next_ns):
                yield heapq.heappop(waiting)[2]

    def _latched(
        self, topics: Sequence[Topic], start_ns: int, end_ns: int
    ) -> Iterator[ExcerptMessage]:
        """Yield what was recorded outside the excerpt and is valid in it.

        A static transform holds before it was recorded, too: a recorder may hear of it late.
        """
        for topic in topics:
            channel, ids = topic.channel, _ids_of([topic])
            if ros_type(channel) not in SPACES | CALIBRATIONS:
                continue
            chunks = chunks_of(channel, self._log.index.parts)
            within = [c for c in chunks if c.ref.start_ns <= end_ns and c.ref.end_ns >= start_ns]
            if not is_static(channel) and any(count_in(chunk, channel) for chunk in within):
                continue
            earlier = [chunk.ref for chunk in chunks if chunk.ref.start_ns < start_ns]
            before = [
                message
                for ref in (earlier if is_static(channel) else earlier[-1:])
                for message in self._copied(self._open(ref), ids)
                if message.log_time_ns < start_ns
            ]
            if is_static(channel):
                late = [] if before else self._first(channel, chunks, ids)
                yield from before or (m for m in late if m.log_time_ns > start_ns + MARGIN_NS)
            else:
                yield from before[-1:]

    def _first(
        self,
        channel: Channel,
        chunks: Sequence[IndexedChunk],
        ids: Mapping[tuple[int, int], Channel],
    ) -> list[ExcerptMessage]:
        """Return the messages of a topic in the first chunk that has any."""
        for chunk in chunks:
            if count_in(chunk, channel) and (found := [*self._copied(self._open(chunk.ref), ids)]):
                return found
        return []

    def _open(self, ref: ChunkRef) -> OpenedChunk:
        reader = self._log.index.readers[ref.part]
        stored = reader.read(ref.offset, ref.length)
        try:
            return OpenedChunk(ref, open_chunk(stored, ref, key=reader.key))
        except ChunkUnreadableError as error:
            return OpenedChunk(ref, memoryview(b""), error)

    def _copied(
        self, opened: OpenedChunk, ids: Mapping[tuple[int, int], Channel]
    ) -> Iterator[ExcerptMessage]:
        """Yield copies of a chunk's messages; damage of it was recorded when it was mined."""
        part, records = opened.ref.part, opened.records
        wanted = {channel_id for number, channel_id in ids if number == part}
        try:
            for stored in messages_in(records, wanted):
                yield ExcerptMessage(
                    channel=self._channels[part, stored.channel_id],
                    log_time_ns=stored.log_time_ns,
                    publish_time_ns=int.from_bytes(
                        records[stored.offset - _TIME_BYTES : stored.offset], "little"
                    ),
                    data=bytes(stored.data),
                )
        except RecordMalformedError:
            return


def _ids_of(topics: Sequence[Topic]) -> dict[tuple[int, int], Channel]:
    return {pair: topic.channel for topic in topics for pair in topic.channel.ids}


def _is_copied(channel: Channel) -> bool:
    return ros_type(channel) in SPACES | CALIBRATIONS | SENSED


def _recorded_channels(index: LogIndex) -> dict[tuple[int, int], ExcerptChannel]:
    """Return the channels of all parts by part and id; equal ones are one object."""
    same: dict[tuple[object, ...], ExcerptChannel] = {}
    found: dict[tuple[int, int], ExcerptChannel] = {}
    for part in index.parts:
        for number, channel in part.channels.items():
            schema = part.schemas.get(channel.schema_id)
            made = ExcerptChannel(
                topic=channel.topic,
                message_encoding=channel.message_encoding,
                schema_name=schema.name if schema else "",
                schema_encoding=schema.encoding if schema else "",
                schema_data=bytes(schema.data) if schema else b"",
                metadata=dict(channel.metadata),
            )
            key = (
                *(made.topic, made.message_encoding, made.schema_name, made.schema_encoding),
                *(made.schema_data, *sorted(made.metadata.items())),
            )
            found[part.number, number] = same.setdefault(key, made)
    return found


def _metadata_of(reader: PartReader) -> Iterator[tuple[str, Mapping[str, str]]]:
    """Yield the metadata records that the summary of a part names; none without a summary."""
    try:
        summary = read_summary(reader)
        for each in [] if summary is None else summary.metadata_indexes[:MAX_METADATA]:
            if each.length > MAX_METADATA_BYTES or each.offset + each.length > reader.size:
                continue
            for record in walk(reader.read(each.offset, each.length)):
                if record.opcode == Opcode.METADATA:
                    read = parse(Metadata, record.body)
                    yield read.name, dict(read.metadata)
    except (RecordMalformedError, PermanentError):
        return
