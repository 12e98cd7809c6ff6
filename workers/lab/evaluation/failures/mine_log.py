"""Mining of one log with the worker's pipeline, compared with its truth per scene."""

from dataclasses import dataclass, replace
from pathlib import Path

from schemas.arrays import NS_PER_S
from schemas.contradiction import Scene
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording
from workers.ingest.read import read_shard
from workers.lab.evaluation.failures.frame_truth import FrameWithTruth, UncertaintyBuffer
from workers.lab.evaluation.failures.planting.variants import Variant
from workers.lab.evaluation.failures.pose_slips import Slip, SlippingOdometry
from workers.lab.evaluation.failures.rows import MinedLog, SceneRow
from workers.lab.evaluation.failures.scene_rows import scene_row
from workers.lab.evaluation.truth.truth import LogTruth, TruthUnusableError
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.lab.simulation.faults.fault_truth import PlantedTruth
from workers.lab.simulation.faults.plan import DisturbanceKind
from workers.parts.protocols import Parts
from workers.pipeline import mine_shard
from workers.version import pipeline_version


@dataclass(frozen=True, slots=True)
class LogJob:
    """A log to mine.

    Attributes:
        recording: The log.
        truth: Folder of the truth of its bucket.
        frames: Number of frames in its truth.
        slips: Pose slips to inject in addition to those that its truth lists.
        variant: Labels and failures to plant; None mines the labels of the log.
    """

    recording: Recording
    truth: Path
    frames: int = 0
    slips: tuple[Slip, ...] = ()
    variant: Variant | None = None


def mine_log(bucket: Bucket, job: LogJob, settings: MiningSettings, parts: Parts) -> MinedLog:
    """Mine a log and compare the result with its truth.

    Args:
        bucket: Bucket of the log.
        job: The log, its truth and its slips.
        settings: Mining settings.
        parts: Odometry, streams and witness.

    Raises:
        TruthUnusableError: If the log has no truth, or that of another log.
        LogUnusableError: If it cannot be mined.
    """
    recording = job.recording
    truth = LogTruth.beside(recording, job.truth)
    if truth is None:
        raise TruthUnusableError(f"{recording.log_id} has no truth in {job.truth}")
    planted = PlantedTruth.beside(job.truth / recording.log_id) or PlantedTruth()
    slips = (*_slips_in(planted), *job.slips)
    if slips:
        parts = replace(parts, odometry=SlippingOdometry(parts.odometry, slips))
    version = pipeline_version(settings, parts)
    scenes: list[SceneRow] = []
    frames, shown = 0, set[int]()
    buffer = parts.supervised if isinstance(parts.supervised, UncertaintyBuffer) else None
    for shard in shards_of_log(bucket, recording, settings, topic=truth.topic):
        reader = read_shard(bucket, recording, shard, settings)
        for mined in mine_shard(shard, reader.frames(), parts, pipeline_version=version):
            seen = _with_truth(mined.scene, truth, before=frames, buffer=buffer)
            cell = (mined.scene.start_ns - shard.anchor_ns) // round(
                settings.grid.scene_s * NS_PER_S
            )
            row, found = scene_row(mined, seen, planted, int(cell))
            shown |= found
            scenes.append(row)
            frames += len(mined.scene.frames)
    return MinedLog(
        log_id=recording.log_id,
        frames=frames,
        scenes=tuple(scenes),
        planted=len(planted.failures),
        unseen=len(planted.failures) - len(shown),
        pipeline_version=version,
    )


def _with_truth(
    scene: Scene, truth: LogTruth, *, before: int, buffer: UncertaintyBuffer | None
) -> list[FrameWithTruth]:
    seen = []
    for number, labelled in enumerate(scene.frames):
        frame = labelled.posed.frame
        place = truth.number_of(frame, position=before + number)
        unsure = {} if buffer is None else buffer.take(frame.stamp_ns)
        seen.append(FrameWithTruth(labelled, truth.of(frame, number=place), unsure))
    return seen


def _slips_in(planted: PlantedTruth) -> tuple[Slip, ...]:
    """Return the odometry slips that the truth of a log lists."""
    return tuple(
        Slip(each.start_ns, each.end_ns, each.strength, each.shift_m)
        for each in planted.disturbances
        if each.kind is DisturbanceKind.ODOMETRY_SLIP
    )
