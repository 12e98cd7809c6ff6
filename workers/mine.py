"""Mining of one shard, from the bucket to encoded records and overlays, for workers and `score`."""

from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from schemas.canonical import sha256
from schemas.contradiction import LabelledFrame
from schemas.frame import LidarFrame, OdometryState
from schemas.labels import Blindness
from schemas.mining import MiningSettings
from schemas.overlay import Overlay, overlay_key
from schemas.score import SceneScore
from schemas.transport.bucket import Bucket
from schemas.transport.overlay_codec import encode_overlay
from schemas.transport.wire import encode_scene_score
from schemas.work import Damage, MiningStats, Recording, Shard
from workers.contradiction.overlay import overlay_of
from workers.contradiction.scoring_inputs import encode_inputs
from workers.ingest.read import read_shard
from workers.memory import peak_memory_bytes
from workers.parts.protocols import Parts
from workers.pictures.scene_pictures import ScenePictures
from workers.pipeline import mine_shard
from workers.stage_timing import StageClock, timed


@dataclass(frozen=True, slots=True)
class MinedRecord:
    """A scored scene, encoded.

    Attributes:
        score: The scene's score.
        record: Its bytes as published.
        sha256: Their digest.
        overlay: Its points, encoded.
        overlay_key: Its key in the artifacts.
    """

    score: SceneScore
    record: bytes
    sha256: str
    overlay: bytes
    overlay_key: str


@dataclass(slots=True)
class MiningReport:
    """Costs and faults of mining one shard; never part of a record.

    Attributes:
        clock: Seconds of each stage.
        damage: Stretches that could not be read.
        odometry: Scored frames by the health of their pose.
        blindness: Scored frames without labels of the self-supervised stream, by cause.
        labels: Returns of the scored frames by that stream's label, by name.
        odometry_problem: The first reason for a pose that is not healthy.
        scenes: Scenes mined.
        frames: Frames scored, warm-up excluded.
        points: Their points.
        bytes_read: From the bucket.
        bytes_needed: As planned.
        range_reads: Requests to the bucket.
    """

    clock: StageClock = field(default_factory=StageClock)
    damage: list[Damage] = field(default_factory=list)
    odometry: Counter[OdometryState] = field(default_factory=Counter)
    blindness: Counter[Blindness] = field(default_factory=Counter)
    labels: Counter[str] = field(default_factory=Counter)
    odometry_problem: str = ""
    scenes: int = 0
    frames: int = 0
    points: int = 0
    bytes_read: int = 0
    bytes_needed: int = 0
    range_reads: int = 0
    pictures: int = 0
    picture_bytes: int = 0

    def add(self, frames: Iterable[LabelledFrame]) -> None:
        """Count the frames of a scene by pose health, blindness and labels."""
        for frame in frames:
            self.odometry[frame.posed.odometry] += 1
            predictive = frame.predictive
            if predictive.health.blindness is not None:
                self.blindness[predictive.health.blindness] += 1
            labels = predictive.labels[frame.posed.frame.valid_mask]
            names = frame.task.labels
            counts = np.bincount(labels, minlength=len(names))
            for name, points in zip(names, counts.tolist(), strict=True):
                self.labels[name] += points

    def stats(self) -> MiningStats:
        """Return the sums."""
        return MiningStats(
            frames=self.frames,
            points=self.points,
            bytes_read=self.bytes_read,
            bytes_needed=self.bytes_needed,
            range_reads=self.range_reads,
            pictures=self.pictures,
            picture_bytes=self.picture_bytes,
            stage_s={name: round(s, 3) for name, s in sorted(self.clock.seconds.items())},
            peak_memory_bytes=peak_memory_bytes(),
        )


def mine_records(
    bucket: Bucket,
    recording: Recording,
    shard: Shard,
    *,
    settings: MiningSettings,
    parts: Parts,
    pipeline_version: str,
    report: MiningReport,
    check: Callable[[], None] = lambda: None,
) -> Generator[MinedRecord, None, None]:
    """Mine a shard, scene by scene; a scene or two are in memory, never the shard.

    Args:
        bucket: Bucket of the recording.
        recording: The log.
        shard: The window of it.
        settings: Settings that all workers share.
        parts: Odometry and streams.
        pipeline_version: Of settings and parts.
        report: Scenes are added while they are mined; reads and damage at the end, also after an
            error or when the caller stops early.
        check: Called at every frame; its exceptions end the mining.

    Raises:
        ObjectChangedError: If an object is no longer the planned one.
        TransientError: If the bucket cannot be read now.
        PermanentError: If the shard can never be mined.
    """
    clock = report.clock
    report.bytes_needed = shard.needed_bytes
    reader = read_shard(bucket, recording, shard, settings)
    pictures = ScenePictures.of(bucket, reader, size=settings.pictures)
    scenes = mine_shard(
        shard,
        clock.drawn("ingest", _checked(reader.frames(), check)),
        timed(parts, clock),
        pipeline_version=pipeline_version,
    )
    try:
        for mined in clock.drawn("contradiction", scenes):
            with clock.stage("encoding"):
                overlay = overlay_of(
                    *(mined.scene, mined.instances, mined.tracks),
                    class_names=parts.supervised.class_names,
                    scoring_inputs=encode_inputs(mined.inputs),
                )
            with clock.stage("pictures"):
                kept = pictures.of_scene(mined.score, overlay)
            with clock.stage("encoding"):
                overlay = replace(overlay, pictures=kept) if kept else overlay
                encoded = _encoded(mined.score, overlay, pipeline_version)
            report.scenes += 1
            report.frames += mined.score.frames
            report.points += mined.score.points
            report.add(mined.scene.frames)
            report.odometry_problem = report.odometry_problem or mined.score.odometry.reason
            yield encoded
    finally:
        report.range_reads = reader.range_reads + pictures.range_reads
        report.bytes_read = reader.bytes_read + pictures.bytes_read
        report.pictures, report.picture_bytes = pictures.pictures, pictures.picture_bytes
        report.damage.extend(reader.damage)


def _encoded(score: SceneScore, overlay: Overlay, pipeline_version: str) -> MinedRecord:
    record = encode_scene_score(score)
    digest = sha256(record)
    return MinedRecord(
        score=score,
        record=record,
        sha256=digest,
        overlay=encode_overlay(overlay),
        overlay_key=overlay_key(
            log_id=score.log_id,
            scene_id=score.scene_id,
            pipeline_version=pipeline_version,
            sha256=digest,
        ),
    )


def _checked(frames: Iterable[LidarFrame], check: Callable[[], None]) -> Iterator[LidarFrame]:
    for frame in frames:
        check()
        yield frame
