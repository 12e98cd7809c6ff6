"""Samples for the calibration of the two-stage rule: object flow of real frames, with truth."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Flow, Mask, Points
from schemas.errors import PermanentError
from schemas.frame import OdometryState
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket, open_bucket
from schemas.work import Recording
from workers.ingest.read import read_shard
from workers.lab.evaluation.truth.truth import (
    TRUTH_DYNAMIC,
    TRUTH_UNKNOWN,
    LogTruth,
    logs_with_truth,
)
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.lidar.preprocessing import PreprocessedFrame, Preprocessor
from workers.paper.scene_flow import SceneFlowSource
from workers.paper.two_stage import flow_between
from workers.parts.protocols import Odometry
from workers.selfsupervised.history import MAX_GAP_NS


@dataclass(frozen=True, slots=True, eq=False)
class MotionSample:
    """Object flow of one frame, in the form that the rule takes, with the truth of each place.

    Attributes:
        log_id: The log.
        places_m: (V, 3) voxels off the ground, metres.
        flow_m: (V, 3) object flow over the frame interval, metres.
        dt_s: Length of the interval.
        weights: (V,) points of each voxel.
        known: (V,) voxels whose motion is known.
        dynamic: (V,) those that move in truth.
        track: (V,) id of the true object, -1 none.
    """

    log_id: str
    places_m: Points
    flow_m: Flow
    dt_s: float
    weights: NDArray[np.int64]
    known: Mask
    dynamic: Mask
    track: NDArray[np.int16]

    @property
    def speed_m_per_s(self) -> NDArray[np.float64]:
        """(V,) speed of each place."""
        speed: NDArray[np.float64] = np.linalg.norm(self.flow_m, axis=1) / self.dt_s
        return speed


def collect_samples(
    bucket_url: str,
    truth: Path,
    *,
    source: SceneFlowSource,
    odometry: Odometry,
    settings: MiningSettings,
    frames: tuple[int, int | None] = (0, None),
    every: int = 1,
    on_progress: Callable[[int], None] = lambda done: None,
) -> list[MotionSample]:
    """Compute the flow of every frame of a bucket that has truth.

    Args:
        bucket_url: URL or path of the bucket.
        truth: Folder of the truth.
        source: Scene flow to calibrate on.
        odometry: Odometry that poses the frames.
        settings: Ingest settings.
        frames: First frame and end, exclusive (None: the rest), counted in each log.
        every: Interval of the frames taken.
        on_progress: Called with the number of samples so far.

    Raises:
        PermanentError: If no frame has both a predecessor and truth.
    """
    bucket = open_bucket(bucket_url)
    found: list[MotionSample] = []
    for recording, log_truth in logs_with_truth(bucket, truth):
        wanted = range(*slice(frames[0], frames[1], every).indices(len(log_truth)))
        for each in _of_log(
            *(bucket, recording, log_truth, source, odometry, settings), wanted=wanted
        ):
            found.append(each)
            on_progress(len(found))
    if not found:
        raise PermanentError(f"no frame of {bucket_url} has both a frame before it and truth")
    return found


def _of_log(
    bucket: Bucket,
    recording: Recording,
    truth: LogTruth,
    source: SceneFlowSource,
    odometry: Odometry,
    settings: MiningSettings,
    *,
    wanted: range,
) -> Iterator[MotionSample]:
    position = 0
    for shard in shards_of_log(bucket, recording, settings, topic=truth.topic):
        prepare = Preprocessor()
        before: tuple[int, PreprocessedFrame] | None = None
        for posed in odometry(read_shard(bucket, recording, shard, settings).frames()):
            frame = posed.frame
            number = truth.number_of(frame, position=position)
            position += 1
            prepared = prepare(frame, posed.odom_from_sensor, None)
            if prepared is None or posed.odometry is OdometryState.LOST:
                before = None
                continue
            age_ns = 0 if before is None else frame.stamp_ns - before[0]
            if before is not None and number in wanted and 0 < age_ns <= MAX_GAP_NS:
                moved = flow_between(prepared, before[1], source)
                labels = truth.of(frame, number=number)
                if labels is not None:
                    judged = prepared.valid_index[prepared.judged_index]
                    known, dynamic, track = _of_voxels(
                        labels.motion[judged],
                        None if labels.track is None else labels.track[judged],
                        prepared.voxels.of_point,
                        len(moved.places_m),
                    )
                    yield MotionSample(
                        log_id=recording.log_id,
                        places_m=moved.places_m,
                        flow_m=moved.flow_m,
                        dt_s=age_ns / NS_PER_S,
                        weights=moved.weights,
                        known=known,
                        dynamic=dynamic,
                        track=track,
                    )
            before = (frame.stamp_ns, prepared)


def _of_voxels(
    motion: NDArray[np.uint8],
    track: NDArray[np.int16] | None,
    voxel: NDArray[np.int32],
    count: int,
) -> tuple[Mask, Mask, NDArray[np.int16]]:
    """Give each voxel the truth of its points: known where all agree, one of their tracks."""
    least = np.full(count, 255, np.uint8)
    most = np.zeros(count, np.uint8)
    np.minimum.at(least, voxel, motion)
    np.maximum.at(most, voxel, motion)
    of_voxel = np.full(count, -1, np.int16)
    if track is not None:
        np.maximum.at(of_voxel, voxel, track)
    return (least == most) & (most != TRUTH_UNKNOWN), most == TRUTH_DYNAMIC, of_voxel
