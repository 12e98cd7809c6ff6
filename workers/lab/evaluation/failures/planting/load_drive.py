"""Reading of a drive: its frames as one shard, its truth, and the answers of the parts."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import LabelledFrame
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import Agreement, FrameLabels, MotionLabel
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording, Shard
from workers.ingest.read import read_shard
from workers.ingest.scenes import cut_scenes
from workers.lab.evaluation.failures.nearest_points import NearestPoints
from workers.lab.evaluation.failures.planting.drive import (
    Drive,
    DriveActor,
    DriveFrame,
    FrameRange,
)
from workers.lab.evaluation.failures.planting.right_labels import (
    OF_COARSE,
    actors_of,
    right_motion,
    whole_objects,
)
from workers.lab.evaluation.failures.planting.true_boxes import (
    boxes_of_frame,
    detected_bodies,
    states_boxes,
)
from workers.lab.evaluation.failures.planting.variants import Answer
from workers.lab.evaluation.truth.truth import (
    TRUTH_DYNAMIC,
    FrameTruth,
    LogTruth,
    TruthUnusableError,
)
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.lab.labels.borders import borders_of
from workers.lab.simulation.models.kinds import GROUND
from workers.parts.protocols import Parts


def shard_of_drive(
    bucket: Bucket,
    recording: Recording,
    truth: LogTruth,
    settings: MiningSettings,
    frames: FrameRange,
) -> tuple[Shard, list[LidarFrame]]:
    """Read the frames of a drive, and plan them as one shard.

    Raises:
        TruthUnusableError: If the range contains less than two frames.
        LogUnusableError: If the log cannot be read.
    """
    plain = settings.model_copy(
        update={"supervised": MiningSettings.model_fields["supervised"].default, "model": ""}
    )
    shard = shards_of_log(bucket, recording, plain, topic=truth.topic)[0]
    read = list(read_shard(bucket, recording, shard, plain).frames())[frames.first : frames.end]
    if len(read) < 2:
        raise TruthUnusableError(
            f"{recording.log_id} has {len(read)} frames in {frames}; planting needs at least two"
        )
    first_ns = read[0].stamp_ns
    begins = {"anchor_ns": first_ns, "warmup_start_ns": first_ns, "start_ns": first_ns}
    return shard.model_copy(update=begins), read


def scenes_of(shard: Shard, frames: Sequence[LidarFrame]) -> tuple[tuple[int, int], ...]:
    """Return the first frame of each scene that is long enough, and the frame after its last."""
    place = {frame.stamp_ns: number for number, frame in enumerate(frames)}
    return tuple(
        (place[scene.frames[0].stamp_ns], place[scene.frames[-1].stamp_ns] + 1)
        for scene in cut_scenes(shard, map(_unlabelled, frames))
        if not scene.too_short
    )


def _unlabelled(frame: LidarFrame) -> LabelledFrame:
    """Return a frame as scenes are cut from: only its stamp counts there."""
    unknown = np.full(len(frame), MotionLabel.UNKNOWN, np.uint8)
    labels = FrameLabels(unknown, np.zeros(len(frame), np.float16))
    agreements = np.full(len(frame), Agreement.NOT_COMPARED, np.uint8)
    return LabelledFrame(PosedFrame(frame, np.eye(4)), labels, labels, agreements)


def check_truth(
    truth: LogTruth,
    read: Sequence[LidarFrame],
    frames: FrameRange,
    *,
    answer: Answer = Answer.POINTS,
) -> list[FrameTruth]:
    """Read the truth of every frame of a drive.

    Raises:
        TruthUnusableError: If a frame has no truth of motion or no objects, or that of another log,
            or no boxes for a model that answers in boxes.
    """
    known = []
    for position, frame in enumerate(read, start=frames.first):
        true = truth.of(frame, number=truth.number_of(frame, position=position))
        if true is None or true.track is None:
            raise TruthUnusableError(
                f"{frame.log_id}, frame {position}: truth has no motion or no tracks; --plant "
                "needs both in every frame (deploy/TRUTH.md), --frames chooses those that have them"
            )
        if answer is Answer.BOXES and not states_boxes(truth, true.number):
            raise TruthUnusableError(
                f"{frame.log_id}, frame {position}: truth has no boxes; --answer boxes needs "
                "tracks.csv with x, y, z, yaw, length, width and height, and poses.npz "
                "(deploy/TRUTH.md)"
            )
        known.append(true)
    return known


def load_drive(
    bucket: Bucket,
    recording: Recording,
    truth: LogTruth,
    settings: MiningSettings,
    parts: Parts,
    *,
    frames: FrameRange,
) -> Drive:
    """Read a drive, and run odometry and the self-supervised stream over it.

    Raises:
        TruthUnusableError: If truth is missing for a frame, or belongs to another log.
        LogUnusableError: If the log cannot be read.
    """
    shard, read = shard_of_drive(bucket, recording, truth, settings, frames)
    posed = list(parts.odometry(iter(read)))
    predictive = list(parts.selfsupervised(iter(posed)))
    known = []
    for number, true in enumerate(check_truth(truth, read, frames)):
        coarse = truth.classes_of(
            read[number], number=truth.number_of(read[number], position=frames.first + number)
        )
        time_s = (read[number].stamp_ns - read[0].stamp_ns) / NS_PER_S
        known.append(_frame(number, time_s, posed[number], predictive[number], true, coarse))
    actors = actors_of(known)
    return Drive(
        recording.log_id,
        shard,
        tuple(_with_bodies(known, truth, actors)),
        scenes_of(shard, read),
        actors,
        seed=0,
        nearest=NearestPoints(keeps=True),
    )


def _with_bodies(
    frames: Sequence[DriveFrame], truth: LogTruth, actors: Sequence[DriveActor]
) -> Iterator[DriveFrame]:
    """Yield the frames with the true boxes of their objects, where truth states them."""
    moving = [False] * len(actors)
    for frame in frames:
        for track in np.unique(frame.track[frame.motion == TRUTH_DYNAMIC]).tolist():
            moving[track] |= track >= 0
    for frame in frames:
        boxes = boxes_of_frame(truth, frame.truth.number, frame.posed, frame.track)
        yield replace(frame, bodies=detected_bodies(boxes, actors, moving))


def _frame(
    number: int,
    time_s: float,
    posed: PosedFrame,
    predictive: FrameLabels,
    true: FrameTruth,
    coarse: NDArray[np.uint8] | None,
) -> DriveFrame:
    frame = posed.frame
    track = np.full(len(frame), -1, np.int16) if true.track is None else true.track
    class_id = OF_COARSE[np.zeros(len(frame), np.uint8) if coarse is None else coarse]
    ground = np.isin(class_id, GROUND)
    if predictive.ground_mask is not None and coarse is None:
        ground = predictive.ground_mask
    track = whole_objects(true, track, points_m=frame.points_m, class_id=class_id, ground=ground)
    return DriveFrame(
        index=number,
        time_s=time_s,
        posed=posed,
        predictive=predictive,
        truth=true,
        motion=right_motion(true, track, ground),
        class_id=class_id,
        track=track,
        ground=ground.astype(np.uint8),
        borders=borders_of(frame.points_m, track),
    )
