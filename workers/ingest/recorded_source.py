"""Source of the model's answer for one lidar: points or boxes of the log, or files next to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.canonical import canonical_json
from schemas.mining import MiningSettings
from schemas.work import BoxSource, Channel, ChunkRef, Damage, RecordedSource
from workers.errors import LogUnusableError
from workers.ingest.boxes.parquet import AROUND_NS, read_box_file
from workers.ingest.boxes.source import FoundBoxes, box_spans, box_topics, find_boxes, find_spaces
from workers.ingest.log_index import LogIndex
from workers.ingest.prediction_files import find_prediction_files, open_predictions
from workers.ingest.recorded_labels import CLASSES_RECORD, find_labels, find_recorded_source
from workers.ingest.shard_windows import Span, StampBounds
from workers.ingest.topic_sampling import Sample
from workers.ingest.topic_spans import spans_of
from workers.ingest.topics import Topic, chunks_of, count_in, without_schema

CHECKED_NS: Final = 20 * NS_PER_S
"""Time from the first cloud on whose boxes a file is checked by, when its log is planned."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundSource:
    """Source of the model's answer, and the chunks that it needs.

    Attributes:
        source: As shards carry it.
        spans: Spans of its topics.
        boxes: Boxes of the log, with a sample of them; None where points or files answer.
    """

    source: RecordedSource
    spans: list[Span] = field(default_factory=list)
    boxes: FoundBoxes | None = None


def find_source(
    index: LogIndex,
    topics: Sequence[Topic],
    sample: Sample,
    samples: Mapping[str, Sample],
    settings: MiningSettings,
    damage: list[Damage],
) -> FoundSource:
    """Find the model's answer for a lidar.

    Files of the setting `predictions` come first, then labels of points, then boxes.

    Args:
        index: Of the log.
        topics: All of the log.
        sample: Of the lidar.
        samples: Of all topics of clouds.
        settings: `predictions`, `recorded_topic` and the task of the stream.
        damage: Chunks that cannot be read are added here.

    Raises:
        LogUnusableError: If there is no answer; the message names what was looked for.
    """
    classes = _classes(index)
    ground = settings.supervised.endswith(":ground")
    if settings.predictions:
        return _files(index, topics, sample, classes, settings)
    wanted = settings.recorded_topic
    points = _points_source(topics, sample, samples, classes, wanted)
    if points is not None and wanted not in ("", (points.channel or sample.topic.channel).topic):
        points = None
    if points is not None:
        return _labels(index, samples, points, damage)
    boxes = None if ground else find_boxes(index, topics, sample, wanted)
    if boxes is None:
        raise LogUnusableError(_nothing_found(sample, topics, wanted, ground=ground))
    source = RecordedSource(
        classes_json=canonical_json(dict(classes or {})).decode(), boxes=boxes.source
    )
    return FoundSource(source, box_spans(index, boxes.source, boxes.bounds, sample), boxes)


def labels_of_further(
    index: LogIndex,
    topics: Sequence[Topic],
    sample: Sample,
    samples: Mapping[str, Sample],
    damage: list[Damage],
) -> tuple[RecordedSource | None, list[Span]]:
    """Find the recorded labels of a further lidar's points, and the spans of their topic.

    The setting `recorded_topic` names the answer for the main lidar, so it is not asked here.

    Returns:
        None where the model on the car labels no point of that lidar.
    """
    found = _points_source(topics, sample, samples, _classes(index), "")
    if found is None or found.channel is None:
        return found, []
    channel = without_schema(found.channel)
    spans = spans_of(index, samples[found.channel.topic], damage)
    return found.model_copy(update={"channel": channel}), spans


def _points_source(
    topics: Sequence[Topic],
    sample: Sample,
    samples: Mapping[str, Sample],
    classes: dict[str, str] | None,
    wanted: str,
) -> RecordedSource | None:
    return find_recorded_source(
        [topic.channel for topic in topics],
        {} if classes is None else {CLASSES_RECORD: classes},
        lidar=sample.topic.channel,
        clouds={
            name: each.clouds
            for name, each in samples.items()
            if wanted in ("", name) or name == sample.topic.channel.topic
        },
    )


def labels_of_log(
    index: LogIndex, topics: Sequence[Topic], sample: Sample, samples: Mapping[str, Sample]
) -> Channel | None:
    """Find the channel of recorded labels, of points or else of boxes, that no setting uses."""
    found = find_labels(
        [topic.channel for topic in topics],
        has_classes=bool(index.metadata(CLASSES_RECORD)),
        lidar=sample.topic.channel,
        clouds={name: each.clouds for name, each in samples.items()},
    )
    boxes = box_topics(topics)
    return found if found is not None or not boxes else boxes[0].channel


def source_of_shard(
    source: RecordedSource, index: LogIndex, lidar: Channel, chunks: Sequence[ChunkRef]
) -> RecordedSource:
    """Return the source of one shard, which knows the number of its first cloud for files."""
    if source.files is None or source.files.kind == "boxes":
        return source
    first_cloud = _first_cloud(index, lidar, chunks)
    files = source.files.model_copy(update={"first_cloud": first_cloud})
    return source.model_copy(update={"files": files})


def _first_cloud(index: LogIndex, lidar: Channel, chunks: Sequence[ChunkRef]) -> int:
    """Count the clouds of a lidar before the first chunk of a shard; -1 where it is not known."""
    read = {(ref.part, ref.offset) for ref in chunks}
    before = 0
    for chunk in chunks_of(lidar, index.parts):
        if (chunk.ref.part, chunk.ref.offset) in read:
            return before
        count = count_in(chunk, lidar)
        if count < 0:
            return -1
        before += count
    return -1


def _classes(index: LogIndex) -> dict[str, str] | None:
    records = index.metadata(CLASSES_RECORD)
    classes: dict[str, str] = {}
    for record in records:
        classes.update(record)
    return classes if records else None


def _files(
    index: LogIndex,
    topics: Sequence[Topic],
    sample: Sample,
    classes: dict[str, str] | None,
    settings: MiningSettings,
) -> FoundSource:
    files, classes_json = find_prediction_files(settings.predictions, index.recording.log_id)
    if files.kind == "boxes":
        if settings.supervised.endswith(":ground"):
            raise LogUnusableError(f"boxes label no ground: choose labels of points ({files.key})")
        spaces = find_spaces(index, topics, sample)
        _check_boxes(settings.predictions, files.key, sample)
        classes_json = classes_json or canonical_json(dict(classes or {})).decode()
        source = RecordedSource(classes_json=classes_json, files=files, boxes=spaces)
        return FoundSource(source, box_spans(index, spaces, StampBounds(), sample))
    return FoundSource(RecordedSource(classes_json=classes_json, files=files))


def _check_boxes(url: str, key: str, sample: Sample) -> None:
    """Read the boxes of the first seconds, so that a file that cannot be used is refused here.

    Raises:
        LogUnusableError: If it is no Parquet of boxes in these units.
    """
    first_ns, last_ns = sample.first_stamp_ns, sample.first_stamp_ns + CHECKED_NS
    read_box_file(
        *(open_predictions(url), key),
        start_ns=max(0, first_ns - AROUND_NS),
        end_ns=last_ns + AROUND_NS,
        clouds_ns=(first_ns - AROUND_NS, last_ns + AROUND_NS),
    )


def _labels(
    index: LogIndex, samples: Mapping[str, Sample], source: RecordedSource, damage: list[Damage]
) -> FoundSource:
    if source.channel is None:
        return FoundSource(source)
    return FoundSource(source, spans_of(index, samples[source.channel.topic], damage))


def _nothing_found(sample: Sample, topics: Sequence[Topic], wanted: str, *, ground: bool) -> str:
    lidar = sample.topic.channel.topic
    if wanted:
        return (
            f"the topic {wanted} of the setting recorded_topic has neither labels of the points of "
            f"{lidar} nor boxes of a known type"
        )
    also = "" if ground else ", and no topic has boxes of a known type"
    found = box_topics(topics) if ground else []
    only = f"; the boxes of {found[0].channel.topic} label no ground" if found else ""
    return (
        f"no recorded labels for {lidar}: neither its points nor a cloud of the same stamp and "
        f"width have a field 'label'{also}{only}"
    )


def spaces_of(source: RecordedSource | None) -> tuple[Channel, ...]:
    """Return the channels of boxes and of what places them, that a shard reads."""
    boxes: BoxSource | None = None if source is None else source.boxes
    if boxes is None:
        return ()
    return (*boxes.moving_spaces, *((boxes.channel,) if boxes.channel is not None else ()))
