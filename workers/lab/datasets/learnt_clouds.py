"""Frames of logs with labels to learn from: truth, or what the self-supervised stream proved."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import tee
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.frame import OdometryState, PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording, Shard
from workers.errors import LogUnusableError
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.lab.datasets.classes import ClassTable
from workers.lab.datasets.images import Cloud
from workers.lab.evaluation.truth.truth import LogTruth
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.parts.protocols import Odometry, Stream

STRETCH_S: Final = 6.0
"""Length of a stretch of a log, seconds; its first frames have their past in the warm-up."""

CANNOT_MOVE: Final = 1
CAN_MOVE: Final = 2
"""Codes of a class of which only that is known."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of a log to learn from.

    Attributes:
        recording: The log.
        shard: Window of the log, with its warm-up.
        frames: Frames taken, counted from the first of the window.
    """

    recording: Recording
    shard: Shard
    frames: range


class Labeller(Protocol):
    """Source of the labels of a log's frames."""

    def clouds(
        self, bucket: Bucket, stretch: Stretch, settings: MiningSettings
    ) -> Iterator[Cloud | None]:
        """Yield the labelled frames of a stretch in order; None where comparisons must end."""
        ...


def stretches_of(
    bucket: Bucket,
    recordings: Sequence[Recording],
    settings: MiningSettings,
    *,
    most: int,
    frames: tuple[int, int | None] | None,
) -> list[Stretch]:
    """Choose the parts of logs to learn from: all frames asked for, or stretches spread evenly.

    Args:
        bucket: Bucket of the logs.
        recordings: The logs.
        settings: Ingest settings.
        most: Frames of all logs together at most.
        frames: First frame and end (None: the rest) of each log, from its start; None: stretches.

    Raises:
        LogUnusableError: If a log cannot be mined.
    """
    share = max(most // max(len(recordings), 1), 1)
    chosen = []
    for recording in recordings:
        if frames is not None:
            first, last = frames
            taken = range(first, min(first + share, last if last is not None else first + share))
            shards = shards_of_log(bucket, recording, settings)[:1]
            chosen += [Stretch(recording, shard, taken) for shard in shards]
            continue
        shards = _short_shards(bucket, recording, settings)
        number = max(min(len(shards), -(-share // round(STRETCH_S * 10))), 1)
        picked = [shards[index * len(shards) // number] for index in range(number)]
        each = -(-share // len(picked)) if picked else 0
        chosen += [Stretch(recording, shard, range(each)) for shard in picked]
    return chosen


def _short_shards(bucket: Bucket, recording: Recording, settings: MiningSettings) -> list[Shard]:
    scene_s = settings.grid.scene_s
    shard_s = max(round(STRETCH_S / scene_s), 1) * scene_s
    grid = settings.grid.model_copy(update={"shard_s": shard_s})
    plan = plan_recording(bucket, recording, settings.model_copy(update={"grid": grid}))
    if plan.refused:
        raise LogUnusableError(f"cannot learn from {recording.log_id}: {plan.refused}")
    return [shard for shard in plan.shards if shard.lidar.topic == plan.lidar_topics[0]]


@dataclass(frozen=True, slots=True)
class ProvedLabels:
    """Labels of the self-supervised stream where it proved them; every other point is unknown.

    Moving: its motion was confirmed by more than one frame and by free space. Static: every point
    that the stream labels so. On a real street labels by one kind of evidence, a third of them, are
    as seldom wrong as those by two. A class is known only as far as motion shows it: what moves can
    move, and the ground cannot.

    Attributes:
        odometry: Poses the frames.
        stream: The stream, best with lookahead.
    """

    odometry: Odometry
    stream: Stream

    def clouds(
        self, bucket: Bucket, stretch: Stretch, settings: MiningSettings
    ) -> Iterator[Cloud | None]:
        """Yield the frames of a stretch with their proved labels; see `Labeller`."""
        read = read_shard(bucket, stretch.recording, stretch.shard, settings).frames()
        posed, given = tee(self.odometry(read))
        for number, (frame, labels) in enumerate(
            _in_window(zip(posed, self.stream(given), strict=True), stretch.shard)
        ):
            if number >= stretch.frames.stop:
                return
            if frame.odometry is OdometryState.LOST:
                yield None
            elif number in stretch.frames:
                motion = proved_motion(labels)
                yield Cloud(
                    frame.frame, _proved_classes(labels, motion), motion, frame.odom_from_sensor
                )


def _in_window(
    pairs: Iterator[tuple[PosedFrame, FrameLabels]], shard: Shard
) -> Iterator[tuple[PosedFrame, FrameLabels]]:
    for frame, labels in pairs:
        if shard.start_ns <= frame.frame.stamp_ns < shard.end_ns:
            yield frame, labels


def proved_motion(labels: FrameLabels) -> NDArray[np.uint8]:
    """Return (N,) motion to learn: 0 unknown or doubtful, 1 static, 2 moving."""
    confirmed = (
        labels.labels == MotionLabel.DYNAMIC if labels.confirmed is None else labels.confirmed
    )
    moving = (labels.labels == MotionLabel.DYNAMIC) & confirmed
    static = labels.labels == MotionLabel.STATIC
    return np.where(moving, np.uint8(2), static.astype(np.uint8))


def _proved_classes(labels: FrameLabels, motion: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return (N,) what motion shows of the class: `CAN_MOVE`, `CANNOT_MOVE` on the ground, or 0."""
    ground = np.zeros(len(motion), np.bool_) if labels.ground_mask is None else labels.ground_mask
    still = ground & (labels.labels == MotionLabel.STATIC)
    classes = np.where(still, np.uint8(CANNOT_MOVE), np.uint8(0))
    return np.where(motion == 2, np.uint8(CAN_MOVE), classes)


@dataclass(frozen=True, slots=True)
class TrueLabels:
    """Labels of a folder of truth.

    Attributes:
        odometry: Poses the frames, as in use.
        truth: The truth of each log, by its id.
        classes: Meaning of the true classes.
    """

    odometry: Odometry
    truth: dict[str, LogTruth]
    classes: ClassTable

    def clouds(
        self, bucket: Bucket, stretch: Stretch, settings: MiningSettings
    ) -> Iterator[Cloud | None]:
        """Yield the frames of a stretch with their truth; see `Labeller`."""
        known = self.truth[stretch.recording.log_id]
        read = read_shard(bucket, stretch.recording, stretch.shard, settings).frames()
        for position, posed in enumerate(self.odometry(read)):
            number = known.number_of(posed.frame, position=position)
            if number >= stretch.frames.stop and position >= stretch.frames.stop:
                return
            if posed.odometry is OdometryState.LOST:
                yield None
                continue
            if number not in stretch.frames:
                continue
            true = known.of(posed.frame, number=number)
            n = len(posed.frame)
            motion = np.zeros(n, np.uint8) if true is None else true.motion
            classes = self.classes.of(known, posed.frame, number=number)
            yield Cloud(posed.frame, classes, motion, posed.odom_from_sensor)
