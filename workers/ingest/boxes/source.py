"""Source of boxes in a log: their topic, the transforms that place them, and their delay."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.log_sources import MAX_SPACE_TOPICS, MAX_STATIC_SPACES, BoxSource, Channel
from schemas.recorded_source import StatedPose
from workers.ingest.boxes.kinds import box_kind
from workers.ingest.boxes.spaces import places_boxes
from workers.ingest.boxes.stated import StatedBoxes, stated_boxes
from workers.ingest.log_index import LogIndex
from workers.ingest.message_lookup import MessageLookup, readable
from workers.ingest.shard_windows import Span, StampBounds
from workers.ingest.topic_sampling import Sample
from workers.ingest.topics import Topic, chunks_of, count_in
from workers.ingest.transforms import has_transforms, is_static, stated_transforms

REACH_NS: Final = NS_PER_S
"""Time around the first cloud in which messages of boxes are sampled, nanoseconds."""

MARGIN_NS: Final = NS_PER_S // 2
"""Variation of delays of a model's answers beyond the sampled ones, nanoseconds."""

MAX_SAMPLED: Final = 32
"""Messages of boxes that planning reads."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundBoxes:
    """Boxes of a log, as planning found them.

    Attributes:
        topic: Their topic.
        source: What a shard needs to read and place them.
        sampled: Some of the first messages.
        bounds: Range of delays from their stamps to their log times.
    """

    topic: Topic
    source: BoxSource
    sampled: tuple[StatedBoxes, ...]
    bounds: StampBounds


def box_topics(topics: Sequence[Topic], wanted: str = "") -> list[Topic]:
    """Return the topics of boxes of a log, the best first.

    Of several, a tracker's and a predictor's come before a detector's, since they state motion.

    Args:
        topics: All of the log.
        wanted: The setting `recorded_topic`; empty: any.
    """
    found = [
        (kind.rank, topic.channel.topic, number)
        for number, topic in enumerate(topics)
        if topic.messages and wanted in ("", topic.channel.topic)
        for kind in [box_kind(topic.channel)]
        if kind is not None
    ]
    return [topics[number] for _, _, number in sorted(found)]


def find_boxes(
    index: LogIndex, topics: Sequence[Topic], sample: Sample, wanted: str = ""
) -> FoundBoxes | None:
    """Find the boxes of a log, and read some of them.

    Args:
        index: Of the log.
        topics: All of the log.
        sample: Of the lidar.
        wanted: The setting `recorded_topic`.
    """
    candidates = box_topics(topics, wanted)
    if not candidates:
        return None
    topic = candidates[0]
    lookup = MessageLookup(index, [topic], log_time_ns=sample.log_times_ns[0], reach_ns=REACH_NS)
    near = lookup.near(topic)[:MAX_SAMPLED]
    sampled: list[StatedBoxes] = []
    delays_ns: list[int] = []
    for message in near:
        for boxes in readable([message], stated_boxes):
            sampled.append(boxes)
            if boxes.stamp_ns:
                delays_ns.append(message.log_time_ns - boxes.stamp_ns)
    source = find_spaces(index, topics, sample).model_copy(update={"channel": _lean(topic.channel)})
    least_ns, most_ns = min(delays_ns, default=0), max(delays_ns, default=0)
    bounds = StampBounds(least_ns - MARGIN_NS, most_ns + MARGIN_NS)
    return FoundBoxes(topic, source, tuple(sampled), bounds)


def find_spaces(index: LogIndex, topics: Sequence[Topic], sample: Sample) -> BoxSource:
    """Find what places boxes: transforms over time and poses by their topics, constant ones read.

    Args:
        index: Of the log.
        topics: All of the log.
        sample: Of the lidar.
    """
    moving = [each for each in topics if each.messages and places_boxes(each.channel)]
    static = [each for each in topics if has_transforms(each.channel) and is_static(each.channel)]
    lookup = MessageLookup(index, static, log_time_ns=sample.log_times_ns[0], reach_ns=REACH_NS)
    poses = {
        (each.parent.strip("/"), each.child.strip("/")): each.parent_from_child
        for one in static
        for stated in readable(lookup.all(one), stated_transforms)
        for each in stated
    }
    return BoxSource(
        moving_spaces=tuple(_lean(each.channel) for each in moving[:MAX_SPACE_TOPICS]),
        static_spaces=tuple(
            StatedPose(
                parent=parent, child=child, parent_from_child=tuple(map(float, placed.ravel()))
            )
            for (parent, child), placed in sorted(poses.items(), key=lambda item: item[0])[
                :MAX_STATIC_SPACES
            ]
        ),
    )


def box_spans(
    index: LogIndex, source: BoxSource, bounds: StampBounds, sample: Sample
) -> list[Span]:
    """Build the spans of boxes and of the transforms that place them.

    Args:
        index: Of the log.
        source: Channels of both.
        bounds: Delays of the boxes.
        sample: Of the lidar, whose delays transforms have.
    """
    channels = [(each, sample.bounds) for each in source.moving_spaces]
    if source.channel is not None:
        channels.append((source.channel, StampBounds() if sample.by_log_time else bounds))
    return [
        Span.of(chunk.ref, (chunk.ref.start_ns, chunk.ref.end_ns), delay, count_in(chunk, channel))
        for channel, delay in channels
        for chunk in chunks_of(channel, index.parts)
    ]


def _lean(channel: Channel) -> Channel:
    """Drop a schema that no decoder needs; definitions of boxes and protobuf stay."""
    if channel.message_encoding == "protobuf":
        return channel
    if box_kind(channel) is not None and channel.schema_encoding in ("ros1msg", "ros2msg"):
        return channel
    return channel.model_copy(update={"schema_base64": ""})
