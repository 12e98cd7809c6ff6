"""Log report: contents of a log from its index or, to verify it, from every chunk."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Channel, ChunkRef, Damage, LogPlan, Recording
from workers.errors import CloudUnreadableError
from workers.ingest.chunk import messages_in
from workers.ingest.damage import DamageList, damaged, damaged_chunk
from workers.ingest.fetch import OpenedChunk, fetch_chunks
from workers.ingest.log_index import LogIndex, index_recording
from workers.ingest.messages import RawMessage
from workers.ingest.plan import plan_index
from workers.ingest.pointcloud import decode_cloud, unsupported_reason
from workers.ingest.records import RecordMalformedError
from workers.ingest.topics import Topic, topics_of

Progress = Callable[[int, int], None]
"""Called with the number of bytes done and of all bytes."""


class TopicReport(BaseModel):
    """One topic of a log."""

    model_config = ConfigDict(frozen=True)

    topic: str
    message_encoding: str
    schema_name: str
    messages: int | None = Field(description="None where the index does not state it.")
    needs: str = Field(default="", description="For a lidar that cannot be read: what it needs.")


class ShardReport(BaseModel):
    """One shard of the log's plan."""

    model_config = ConfigDict(frozen=True)

    name: str
    start_ns: int
    end_ns: int
    chunks: int
    needed_bytes: int


class ModelAnswer(BaseModel):
    """Answer of the model on the car in the first frames of a log."""

    model_config = ConfigDict(frozen=True)

    form: str = Field(description="`points`, `boxes`, or `files` of either.")
    source: str = Field(description="Topic or file.")
    frames: int = Field(description="Frames that were read.")
    labelled_share: float = Field(description="Share of the returns that can contradict at all.")
    unanswered_share: float = Field(description="Share of the frames without an answer.")
    reason: str = Field(default="", description="What the answers do not state.")
    problems: tuple[str, ...] = Field(default=(), description="What is wrong with them.")

    @property
    def sentence(self) -> str:
        """Describe the answer in a sentence."""
        said = f"{self.form} on {self.source}: {self.labelled_share:.0%} of the returns of the "
        said += f"first {self.frames} frames can contradict"
        if self.unanswered_share:
            said += f", {self.unanswered_share:.0%} of these frames have no answer"
        return f"{said}; {self.reason}" if self.reason else said


class LogReport(BaseModel):
    """Contents of a log."""

    model_config = ConfigDict(frozen=True)

    log_id: str
    vehicle: str
    date: str
    software_version: str
    parts: tuple[str, ...] = Field(description="Keys of its objects.")
    bytes: int = Field(description="Of all its objects.")
    start_ns: int | None = Field(description="Log time of the first message; None without any.")
    duration_s: float | None = Field(description="Until the last message.")
    topics: tuple[TopicReport, ...]
    lidar_topic: str | None = Field(description="The densest lidar that is mined; None without.")
    lidar_topics: tuple[str, ...]
    joined: tuple[str, ...] = Field(
        default=(),
        description="Lidars that are joined to it, and whether their points have labels.",
    )
    odometry_topic: str | None = Field(
        description="Topic of recorded motion, compared with the odometry; None without."
    )
    place_topic: str | None = Field(
        default=None, description="Topic of global places of the car; None without."
    )
    frames: int | None = Field(
        description="Well-formed clouds of the lidars; by the index alone, those it counts."
    )
    verified: bool = Field(description="True if every chunk was read.")
    damage: tuple[Damage, ...]
    shards: tuple[ShardReport, ...]
    answer: ModelAnswer | None = Field(
        default=None, description="Of the model on the car; None where the log has none."
    )
    refused: str = Field(description="Why it cannot be mined; empty when it can.")
    range_reads: int
    bytes_read: int


def inspect_recording(
    bucket: Bucket,
    recording: Recording,
    settings: MiningSettings,
    *,
    verify: bool = False,
    progress: Progress | None = None,
) -> LogReport:
    """Report the contents of a recording.

    Args:
        bucket: Its bucket.
        recording: Its objects.
        settings: Settings of the mining.
        verify: Read, check and decode every chunk, instead of trusting the index.
        progress: Called with the progress of verifying.

    Raises:
        NotMcapError: If a part is no MCAP file.
        ObjectChangedError: If a part is no longer the listed one.
    """
    index = index_recording(bucket, recording)
    plan = plan_index(index, settings)
    topics = topics_of(index.parts)
    messages = [topic.messages for topic in topics]
    mined = [topic.messages for topic in topics if _is_mined(topic, plan)]
    frames = None if -1 in mined else sum(mined)
    damage = list(plan.damage)
    if verify:
        found = _verify(index, topics, plan, progress)
        messages = [sum(found.counts[each] for each in topic.channel.ids) for topic in topics]
        frames = found.clouds
        damage = _merged(damage, found.damage)
    times = [chunk.ref for part in index.parts for chunk in part.chunks if chunk.ref.end_ns]
    start_ns = min((ref.start_ns for ref in times), default=None)
    end_ns = max((ref.end_ns for ref in times), default=0)
    return LogReport(
        log_id=plan.log_id,
        vehicle=plan.vehicle,
        date=plan.date,
        software_version=plan.software_version,
        parts=tuple(part.key for part in recording.parts),
        bytes=sum(part.size for part in recording.parts),
        start_ns=start_ns,
        duration_s=None if start_ns is None else (end_ns - start_ns) / NS_PER_S,
        topics=tuple(
            TopicReport(
                topic=topic.channel.topic,
                message_encoding=topic.channel.message_encoding,
                schema_name=topic.channel.schema_name,
                messages=None if count < 0 else count,
                needs=unsupported_reason(topic.channel),
            )
            for topic, count in zip(topics, messages, strict=True)
        ),
        lidar_topic=plan.lidar_topics[0] if plan.lidar_topics else None,
        lidar_topics=plan.lidar_topics,
        joined=_joined(plan, settings),
        odometry_topic=next((each.motion.topic for each in plan.shards if each.motion), None),
        place_topic=next((each.fixes.topic for each in plan.shards if each.fixes), None),
        frames=frames,
        verified=verify,
        damage=tuple(damage),
        shards=tuple(
            ShardReport(
                name=shard.name,
                start_ns=shard.start_ns,
                end_ns=shard.end_ns,
                chunks=len(shard.chunks),
                needed_bytes=shard.needed_bytes,
            )
            for shard in plan.shards
        ),
        refused=plan.refused,
        range_reads=index.range_reads,
        bytes_read=index.bytes_read,
    )


@dataclass(slots=True, eq=False)
class _Found:
    """Results of reading every chunk.

    Attributes:
        counts: Messages by part and channel id.
        clouds: Well-formed clouds of the mined lidars.
        damage: Stretches that could not be read.
    """

    counts: Counter[tuple[int, int]] = field(default_factory=Counter)
    clouds: int = 0
    damage: DamageList = field(default_factory=DamageList)


def _verify(
    index: LogIndex, topics: Sequence[Topic], plan: LogPlan, progress: Progress | None
) -> _Found:
    found = _Found()
    channels = {each: topic.channel for topic in topics for each in topic.channel.ids}
    lidars = {
        each: topic.channel
        for topic in topics
        if _is_mined(topic, plan)
        for each in topic.channel.ids
    }
    refs = [chunk.ref for part in index.parts for chunk in part.chunks]
    done, total = 0, sum(ref.length for ref in refs)
    for opened in fetch_chunks(index.readers, refs):
        key = index.readers[opened.ref.part].key
        _verify_chunk(opened, key, channels, lidars, found)
        done += opened.ref.length
        if progress is not None:
            progress(done, total)
    return found


def _verify_chunk(
    opened: OpenedChunk,
    key: str,
    channels: Mapping[tuple[int, int], Channel],
    lidars: Mapping[tuple[int, int], Channel],
    found: _Found,
) -> None:
    ref = opened.ref
    if opened.error is not None:
        found.damage.append(damaged_chunk(key, ref, opened.error.problem))
        return
    nameless = 0
    try:
        for stored in messages_in(opened.records):
            where = (ref.part, stored.channel_id)
            found.counts[where] += 1
            nameless += where not in channels
            if where in lidars:
                message = RawMessage(lidars[where], stored.log_time_ns, stored.data)
                found.clouds += _is_well_formed(message, key, ref, found.damage)
    except RecordMalformedError as error:
        found.damage.append(damaged_chunk(key, ref, error.problem))
    if nameless:
        problem = f"{nameless} messages of channels whose records are lost"
        found.damage.append(damaged_chunk(key, ref, problem))


def _is_well_formed(message: RawMessage, key: str, ref: ChunkRef, damage: list[Damage]) -> bool:
    try:
        decode_cloud(message)
    except CloudUnreadableError as error:
        what = str(error)
        damage.append(damaged(key=key, offset=ref.offset, length=len(message.data), what=what))
        return False
    return True


def _joined(plan: LogPlan, settings: MiningSettings) -> tuple[str, ...]:
    """Say for each further lidar whether the model on the car labels its points."""
    shard = next(iter(plan.shards), None)
    if shard is None or not settings.takes_recorded:
        return () if shard is None else tuple(each.channel.topic for each in shard.further)
    boxes = shard.recorded is not None and shard.recorded.boxes is not None
    return tuple(
        each.channel.topic
        if boxes or each.recorded is not None
        else f"{each.channel.topic} (no recorded labels: its points cannot contradict)"
        for each in shard.further
    )


def _is_mined(topic: Topic, plan: LogPlan) -> bool:
    return any(topic.channel.ids == shard.lidar.ids for shard in plan.shards)


def _merged(planned: Sequence[Damage], found: Sequence[Damage]) -> list[Damage]:
    """Return both without duplicates, in the order of their places."""
    return sorted(
        {(each.key, each.offset, each.what): each for each in (*planned, *found)}.values(),
        key=lambda each: (each.key, each.offset, each.what),
    )
