"""Answer of the model in a log, by its first frames: what it labels, and what it leaves open."""

from collections.abc import Iterator
from itertools import islice, tee
from typing import Final

import numpy as np

from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import RecordedSource, Recording, Shard
from workers.ingest.inspect import ModelAnswer
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.supervised.recorded import Recorded

FRAMES: Final = 10
"""Frames that are read: a second at 10 Hz, long enough for the path of a track."""

RECORDED: Final = "recorded"


def read_answer(
    bucket: Bucket, recording: Recording, settings: MiningSettings, *, frames: int = FRAMES
) -> ModelAnswer | None:
    """Read the model's answer to the first frames of a log.

    Args:
        bucket: Bucket of the log.
        recording: The log.
        settings: Where the answer is; another supervised stream than `recorded` is replaced.
        frames: Frames to read.

    Returns:
        None where the log has no answer, or cannot be mined.

    Raises:
        BucketUnreachableError: If the bucket does not answer.
        LogUnusableError: If a file of predictions cannot be read.
    """
    settings = settings.model_copy(update={"supervised": RECORDED, "model": ""})
    plan = plan_recording(bucket, recording, settings)
    if plan.refused or not plan.shards:
        return None
    shard = plan.shards[0]
    if shard.recorded is None:
        return None
    reader = read_shard(bucket, recording, shard, settings)
    read = reader.frames()
    returns = labelled = answered = count = 0
    reasons: list[str] = []
    stream = Recorded()
    for frame, labels in _labelled(stream, islice(read, frames)):
        valid = frame.valid_mask
        count += 1
        returns += int(valid.sum())
        labelled += int((labels.labels[valid] < stream.task.unknown).sum())
        answered += labels.health.answered
        reasons.append(labels.health.reason)
    read.close()
    form, source = _source_of(shard, shard.recorded)
    return ModelAnswer(
        form=form,
        source=source,
        frames=count,
        labelled_share=round(labelled / returns, 4) if returns else 0.0,
        unanswered_share=round(1 - answered / count, 4) if count else 0.0,
        reason=next((each for each in reasons if each), ""),
        problems=tuple(damage.what for damage in reader.damage),
    )


def _labelled(
    stream: Recorded, frames: Iterator[LidarFrame]
) -> Iterator[tuple[LidarFrame, FrameLabels]]:
    """Label frames without poses: what moves may be wrong, what is labelled at all is not."""
    kept, given = tee(frames)
    posed = (PosedFrame(frame, np.eye(4)) for frame in given)
    return zip(kept, stream(posed), strict=True)


def _source_of(shard: Shard, recorded: RecordedSource) -> tuple[str, str]:
    if recorded.files is not None:
        return "files", recorded.files.key
    if recorded.boxes is not None and recorded.boxes.channel is not None:
        return "boxes", recorded.boxes.channel.topic
    return "points", (recorded.channel or shard.lidar).topic
