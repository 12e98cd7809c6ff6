"""Planning of a recording: its lidars and shards, from its index and one chunk."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from schemas.bounds import MAX_PLAN_BYTES, MAX_TEXT
from schemas.camera import RECORDED, CameraCalibration
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.visible import visible
from schemas.work import Channel, ChunkRef, Damage, LogPlan, Recording, Shard
from workers.errors import LogUnusableError, NotMcapError, PredictionsMissingError
from workers.ingest.camera_calibration import find_calibration
from workers.ingest.camera_messages import has_images
from workers.ingest.damage import DamageList, damaged
from workers.ingest.footer import PredictionsAwaitedError, TruncatedPart
from workers.ingest.frames import intensity_scale_of
from workers.ingest.global_fixes import find_fixes
from workers.ingest.identity import METADATA_RECORD, Identity, identify
from workers.ingest.joined_lidars import FoundLidar, find_further
from workers.ingest.lidar import choose_lidars, lidar_properties
from workers.ingest.limits import MAX_CLOUD_TOPICS
from workers.ingest.log_index import LogIndex, index_recording
from workers.ingest.pointcloud import is_cloud, unsupported_reason
from workers.ingest.prediction_files import need_prediction_files
from workers.ingest.recorded_motion import find_motion
from workers.ingest.recorded_source import (
    FoundSource,
    find_source,
    labels_of_log,
    source_of_shard,
)
from workers.ingest.shard_windows import Spans, cut_windows
from workers.ingest.topic_sampling import Sample, sample_end, sample_middle, sample_topics
from workers.ingest.topic_spans import motion_spans, spans_within_reach
from workers.ingest.topics import Topic, topics_of, without_schema

MAX_INDEX_READS: Final = 3
"""Reads of each part's index; where fewer were enough, the end of the log is also sampled."""

MAX_NAMED_TOPICS: Final = 20

MOST_FOR_MOTION: Final = 0.1
"""Share of a shard's bytes up to which it also reads chunks of motion and fixes without clouds.

Mostly those messages are between the clouds. Stored together with cameras they would cost reading
the log's images."""


def plan_recording(
    bucket: Bucket,
    recording: Recording,
    settings: MiningSettings,
    *,
    settled: bool = True,
    waits: bool = False,
    on_truncated: Callable[[TruncatedPart], None] = lambda part: None,
    on_unread_labels: Callable[[str], None] = lambda topic: None,
) -> LogPlan:
    """Find the lidars of a recording and cut it into shards.

    A log that cannot be mined is refused inside the plan, in one sentence, and not by an error.

    Args:
        bucket: Its bucket.
        recording: Its parts.
        settings: Grid and parts.
        settled: Use a part without a valid footer as far as it goes.
        waits: Wait for the predictions that the settings want, where there are none.
        on_truncated: Called with every such part.
        on_unread_labels: Called with the topic of a lidar's recorded labels, where the settings
            use another stream. With `lidar_topic` set, only labels on that topic are found.

    Raises:
        StillGrowingError: If a part has no valid footer, and the recording is not settled.
        PredictionsAwaitedError: If its predictions are missing, and it waits for them.
        ObjectChangedError: If a part is no longer the listed one.
        BucketUnreachableError: If the bucket does not answer.
    """
    if waits and settings.predictions:
        try:
            need_prediction_files(settings.predictions, recording.log_id)
        except PredictionsMissingError as error:
            raise PredictionsAwaitedError(str(error)) from None
    try:
        index = index_recording(bucket, recording, settled=settled)
    except (NotMcapError, LogUnusableError) as error:
        return LogPlan(log_id=recording.log_id, refused=visible(str(error), limit=MAX_TEXT))
    for part in index.truncated:
        on_truncated(part)
    return plan_index(index, settings, on_unread_labels=on_unread_labels)


def plan_index(
    index: LogIndex,
    settings: MiningSettings,
    *,
    on_unread_labels: Callable[[str], None] = lambda topic: None,
) -> LogPlan:
    """Plan a recording whose index is known; the arguments are those of `plan_recording`."""
    damage = DamageList()
    left_out: list[str] = []

    def leave_out(channel: Channel, why: str) -> None:
        if is_cloud(channel):
            left_out.append(f"the topic {channel.topic} {why}: it is not mined")

    topics = topics_of(index.parts, on_left_out=leave_out)
    identity = Identity()
    chosen: list[Sample] = []
    shards: list[Shard] = []
    refused = ""
    plan_bytes = 0
    try:
        identity = identify(
            index.recording.log_id,
            index.metadata(METADATA_RECORD),
            path_template=settings.path_template,
        )
        for remark in (*left_out, *identity.remarks):
            damage.append(damaged(key=index.readers[0].key, offset=0, length=0, what=remark))
        samples = sample_topics(index, _candidates(topics, settings), damage)
        chosen = _choose(index, samples, topics, settings, damage)
        for sample in (*chosen, *(samples[name] for name in settings.lidar_names[1:])):
            affordable = index.range_reads <= MAX_INDEX_READS * len(index.parts)
            if sample.clocks_differ and affordable:
                sample_end(index, sample)
        further = find_further(index, topics, samples, settings, damage)
        anchor_ns = min(sample.first_stamp_ns for sample in chosen)
        for sample in chosen:
            recorded = None
            if settings.takes_recorded:
                recorded = _recorded(index, topics, sample, samples, settings, damage)
            elif found := labels_of_log(index, topics, sample, samples):
                on_unread_labels(found.topic)
            channel = without_schema(sample.topic.channel)
            camera = _camera(index, topics, sample, settings)
            motion = find_motion(topics, settings.odometry_topic)
            fixes = find_fixes(topics, settings.place_topic)
            has_cameras = _has_cameras(index, topics)
            lidar = _Lidar(
                *(channel, anchor_ns, recorded, motion, fixes, camera, has_cameras, identity),
                further=further,
            )
            for shard in _shards(index, lidar, sample, settings, damage):
                plan_bytes += len(shard.model_dump_json())
                if plan_bytes > MAX_PLAN_BYTES:
                    raise LogUnusableError(
                        f"its plan would take more than {MAX_PLAN_BYTES} bytes: its chunks are too "
                        "many, or their times lie; split the recording, or repair its index"
                    )
                shards.append(shard)
    except LogUnusableError as error:
        refused, shards = visible(str(error), limit=MAX_TEXT), []
    return LogPlan(
        log_id=index.recording.log_id,
        vehicle=identity.vehicle,
        date=identity.date,
        software_version=identity.software_version,
        lidar_topics=tuple(sample.topic.channel.topic for sample in chosen),
        shards=tuple(shards),
        damage=tuple(DamageList((*index.damage, *_unread_damage(damage, shards, index)))),
        truncated_parts=sum(1 for _ in index.truncated),
        refused=refused,
        range_reads=index.range_reads,
        bytes_read=index.bytes_read,
    )


@dataclass(frozen=True, slots=True)
class _Lidar:
    """Common properties of all shards of one lidar of one log."""

    channel: Channel
    anchor_ns: int
    recorded: FoundSource | None
    motion: Channel | None
    fixes: Channel | None
    camera: CameraCalibration | None
    has_cameras: bool
    identity: Identity
    further: Sequence[FoundLidar] = ()


def _candidates(topics: Sequence[Topic], settings: MiningSettings) -> list[Topic]:
    clouds = [topic for topic in topics if is_cloud(topic.channel) and topic.messages]
    names = settings.lidar_names
    for wanted in names:
        if not any(wanted in ("", topic.channel.topic) for topic in clouds):
            raise LogUnusableError(_no_lidar(topics, wanted))
    if settings.lidar_topic and not settings.takes_recorded:
        clouds = [topic for topic in clouds if topic.channel.topic in names]
    # of a topic recorded in two ways, the one with more messages is meant
    by_name = {
        topic.channel.topic: topic for topic in sorted(clouds, key=lambda topic: topic.messages)
    }
    if len(by_name) > MAX_CLOUD_TOPICS and not settings.lidar_topic:
        raise LogUnusableError(
            f"{len(by_name)} topics hold point clouds, more than {MAX_CLOUD_TOPICS}: set "
            "lidar_topic to the one to be mined"
        )
    for name in sorted(by_name.keys() - set(names))[MAX_CLOUD_TOPICS:]:
        del by_name[name]
    return [by_name[name] for name in sorted(by_name)]


def _no_lidar(topics: Sequence[Topic], wanted: str) -> str:
    names = [topic.channel.topic for topic in topics]
    shown = ", ".join(names[:MAX_NAMED_TOPICS]) + (", …" if names[MAX_NAMED_TOPICS:] else "")
    listed = f"topics are {shown}" if names else "there are no topics"
    needs = [
        f"{topic.channel.topic} {reason}"
        for topic in topics
        if (reason := unsupported_reason(topic.channel)) and wanted in ("", topic.channel.topic)
    ]
    if needs:
        return f"no lidar that can be read: {'; '.join(needs)}; {listed}"
    if wanted:
        return f"no point clouds on the configured lidar topic {wanted}; {listed}"
    return f"no lidar in the log: no topic holds point clouds; {listed}"


def _choose(
    index: LogIndex,
    samples: Mapping[str, Sample],
    topics: Sequence[Topic],
    settings: MiningSettings,
    damage: Sequence[Damage],
) -> list[Sample]:
    wanted = settings.lidar_names
    if all(name in samples for name in wanted):
        return [samples[wanted[0]]]
    if not samples or settings.lidar_topic:
        names = ", ".join(topic.channel.topic for topic in _candidates(topics, settings))
        if len(wanted) > 1:
            names = ", ".join(name for name in wanted if name not in samples)
        harm = f" ({len(damage)} damaged chunks)" if damage else ""
        raise LogUnusableError(f"no lidar in the log: no cloud of {names} can be read{harm}")
    properties = {topic: lidar_properties(sample.clouds) for topic, sample in samples.items()}
    chosen = choose_lidars(properties)
    if not chosen:
        for topic, sample in samples.items():
            sample_middle(index, sample)
            if sample.later_clouds:
                properties[topic] = lidar_properties(sample.later_clouds)
        chosen = choose_lidars(properties)
    if not chosen:
        found = "; ".join(f"{topic}: {properties[topic].why_not}" for topic in sorted(properties))
        raise LogUnusableError(
            f"no dense lidar that sees all around: {found}; set lidar_topic to mine one of them"
        )
    return [samples[topic] for topic in chosen]


def _recorded(
    index: LogIndex,
    topics: Sequence[Topic],
    sample: Sample,
    samples: Mapping[str, Sample],
    settings: MiningSettings,
    damage: list[Damage],
) -> FoundSource:
    found = find_source(index, topics, sample, samples, settings, damage)
    if found.source.channel is None:
        return found
    channel = without_schema(found.source.channel)
    return replace(found, source=found.source.model_copy(update={"channel": channel}))


def _camera(
    index: LogIndex, topics: Sequence[Topic], sample: Sample, settings: MiningSettings
) -> CameraCalibration | None:
    if settings.camera == RECORDED:
        return find_calibration(index, topics, sample)
    return CameraCalibration.model_validate_json(settings.camera) if settings.camera else None


def _shards(
    index: LogIndex,
    lidar: _Lidar,
    sample: Sample,
    settings: MiningSettings,
    damage: list[Damage],
) -> Iterator[Shard]:
    spans, anchor_ns = spans_within_reach(
        index, sample, anchor_ns=lidar.anchor_ns, grid=settings.grid, damage=damage
    )
    labels = [] if lidar.recorded is None else list(lidar.recorded.spans)
    labels += [span for each in lidar.further for span in each.spans]
    source = None if lidar.recorded is None else lidar.recorded.source
    scale = settings.intensity_scale or intensity_scale_of([*sample.clouds, *sample.later_clouds])
    chunks = Spans([*spans, *labels])
    moved = motion_spans(index, lidar.motion, sample, spans)
    placed = motion_spans(index, lidar.fixes, sample, [*spans, *moved])
    wider = [Spans([*spans, *labels, *more]) for more in (placed, moved, [*placed, *moved]) if more]
    for window in cut_windows(
        spans,
        grid=settings.grid,
        anchor_ns=anchor_ns,
        least_step_ns=sample.least_step_ns,
        ahead_ns=settings.ahead_ns,
    ):
        reads, most = chunks, (1.0 + MOST_FOR_MOTION) * _length(window.reads(chunks))
        for more in wider:
            reads = more if _length(window.reads(more)) <= most else reads
        read = tuple(window.reads(reads))
        yield Shard(
            log_id=index.recording.log_id,
            index=window.index,
            lidar=lidar.channel,
            further=tuple(each.lidar for each in lidar.further),
            recorded=source and source_of_shard(source, index, lidar.channel, read),
            motion=None if lidar.motion is None else without_schema(lidar.motion),
            fixes=None if lidar.fixes is None else without_schema(lidar.fixes),
            camera=lidar.camera,
            has_cameras=lidar.has_cameras,
            anchor_ns=anchor_ns,
            warmup_start_ns=window.warmup_start_ns,
            start_ns=window.start_ns,
            end_ns=window.end_ns,
            lookahead_end_ns=window.lookahead_end_ns,
            before_lookahead_end_ns=window.before_lookahead_end_ns,
            scene_s=settings.grid.scene_s,
            first_of_log=window.first_of_log,
            last_of_log=window.last_of_log,
            chunks=read,
            needed_bytes=_length(window.needs(reads)),
            by_log_time=sample.by_log_time,
            intensity_scale=scale,
            vehicle=lidar.identity.vehicle,
            date=lidar.identity.date,
            software_version=lidar.identity.software_version,
        )


def _has_cameras(index: LogIndex, topics: Sequence[Topic]) -> bool:
    """Return whether pictures can be read without a scan: a log without index is scanned once."""
    is_indexed = not any(part.recovered for part in index.parts)
    return is_indexed and any(has_images(topic.channel) and topic.messages for topic in topics)


def _length(refs: Iterable[ChunkRef]) -> int:
    return sum(ref.length for ref in refs)


def _unread_damage(
    damage: Iterable[Damage], shards: Iterable[Shard], index: LogIndex
) -> list[Damage]:
    """Return the damage found in planning that no shard will read, and so report, again."""
    read = {(index.readers[ref.part].key, ref.offset) for shard in shards for ref in shard.chunks}
    unique = {(each.key, each.offset, each.what): each for each in damage}
    return [each for each in unique.values() if (each.key, each.offset) not in read]
