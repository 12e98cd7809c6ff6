"""Mining of one variant of a drive: the same pipeline, with the answers that labels do not change.

Odometry and the self-supervised stream never see the recorded labels. Their answers are computed
once for a drive and replayed to `mine_shard` for each variant. A variant gets the same record as a
log that contains its labels.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from schemas.boxes import RecordedBoxes
from schemas.frame import LidarFrame, PosedFrame, RecordedLabels
from schemas.labels import FrameLabels
from schemas.task import Task
from workers.lab.evaluation.failures.frame_truth import FrameWithTruth
from workers.lab.evaluation.failures.planting.boxes import boxes_of_variant
from workers.lab.evaluation.failures.planting.drive import Drive
from workers.lab.evaluation.failures.planting.labels import labels_of_variant
from workers.lab.evaluation.failures.planting.variants import Answer, Variant, place_failures
from workers.lab.evaluation.failures.rows import MinedLog, SceneRow
from workers.lab.evaluation.failures.scene_rows import scene_row
from workers.lab.simulation.faults.fault_truth import PlantedFaults
from workers.parts.protocols import Parts
from workers.pipeline import MinedScene, mine_shard


@dataclass(frozen=True, slots=True)
class ReplayedOdometry:
    """Poses of a drive, replayed.

    Attributes:
        version: Of the odometry that computed them.
        posed: The frames with their poses.
    """

    version: str
    posed: Sequence[PosedFrame]

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        """Yield each frame with its pose."""
        for frame, posed in zip(frames, self.posed, strict=True):
            yield replace(posed, frame=frame)


@dataclass(frozen=True, slots=True)
class ReplayedStream:
    """Labels of a drive by a stream that does not see recorded labels, replayed.

    Attributes:
        task: Task of its labels.
        version: Of the stream that computed them.
        class_names: Of that stream.
        answers: Its labels of each frame.
    """

    task: Task
    version: str
    class_names: tuple[str, ...]
    answers: Sequence[FrameLabels]

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame."""
        for _, labels in zip(frames, self.answers, strict=True):
            yield labels


def replaying(parts: Parts, drive: Drive) -> Parts:
    """Return the parts with odometry and self-supervised stream replayed for a drive."""
    stream = parts.selfsupervised
    return replace(
        parts,
        odometry=ReplayedOdometry(parts.odometry.version, [each.posed for each in drive.frames]),
        selfsupervised=ReplayedStream(
            stream.task,
            stream.version,
            stream.class_names,
            [each.predictive for each in drive.frames],
        ),
    )


def mine_answers(
    drive: Drive,
    answers: Iterable[RecordedLabels | RecordedBoxes | None],
    parts: Parts,
    *,
    pipeline_version: str,
) -> Iterator[MinedScene]:
    """Mine a drive with these recorded labels or boxes, one answer of each frame.

    The result is that of a log which contains them, bit for bit.
    """
    frames = (
        replace(frame.posed.frame, boxes=answer)
        if answer is None or isinstance(answer, RecordedBoxes)
        else replace(frame.posed.frame, recorded=answer)
        for frame, answer in zip(drive.frames, answers, strict=True)
    )
    return mine_shard(
        drive.shard, frames, replaying(parts, drive), pipeline_version=pipeline_version
    )


def mine_variant(
    drive: Drive, variant: Variant, parts: Parts, *, pipeline_version: str
) -> MinedLog:
    """Mine a variant of a drive and compare the result with its truth.

    Args:
        drive: The drive.
        variant: Its plan.
        parts: Parts of the settings, with the recorded supervised stream.
        pipeline_version: Of settings and parts.
    """
    failures = place_failures(drive, variant)
    start_ns = drive.frames[0].posed.frame.stamp_ns
    planted = PlantedFaults(failures=tuple(failures)).truth(start_ns)
    rows: list[SceneRow] = []
    shown = set[int]()
    answers_of = boxes_of_variant if variant.answer is Answer.BOXES else labels_of_variant
    answers = answers_of(drive, variant, failures)
    mined = mine_answers(drive, answers, parts, pipeline_version=pipeline_version)
    place = {frame.posed.frame.stamp_ns: frame for frame in drive.frames}
    for cell, each in enumerate(mined):
        seen = [FrameWithTruth(one, place[one.stamp_ns].truth) for one in each.scene.frames]
        row, found = scene_row(each, seen, planted, cell, nearest=drive.nearest)
        rows.append(row)
        shown |= found
    return MinedLog(
        log_id=f"{drive.log_id}#{variant.number}",
        frames=len(drive.frames),
        scenes=tuple(rows),
        planted=len(failures),
        unseen=len(failures) - len(shown),
        failures=planted.failures,
        shown=tuple(sorted(shown)),
        pipeline_version=pipeline_version,
    )
