"""A real drive with truth, and the answers of the parts that planted labels do not change."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Mask, Points, Transform
from schemas.contradiction import LabelledFrame
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import Agreement, FrameLabels, MotionLabel
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from schemas.work import Recording, Shard
from workers.ingest.read import read_shard
from workers.ingest.scenes import cut_scenes
from workers.lab.evaluation.failures.nearest_points import NearestPoints
from workers.lab.evaluation.truth.class_table import COARSE, coarse_of_name
from workers.lab.evaluation.truth.truth import (
    TRUTH_DYNAMIC,
    TRUTH_STATIC,
    TRUTH_UNKNOWN,
    FrameTruth,
    LogTruth,
    TruthUnusableError,
)
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.lab.labels.borders import Borders, borders_of
from workers.lab.labels.noise import SeenFrame
from workers.lab.simulation.models.kinds import GROUND, StreetClass
from workers.parts.protocols import Parts

_STREET_CLASS: Final[dict[str, StreetClass]] = {
    "none": StreetClass.OBJECT,
    "car": StreetClass.CAR,
    "large_vehicle": StreetClass.TRUCK,
    "two_wheeler": StreetClass.CYCLIST,
    "pedestrian": StreetClass.PEDESTRIAN,
    "road": StreetClass.ROAD,
    "sidewalk": StreetClass.SIDEWALK,
    "other_ground": StreetClass.TERRAIN,
    "vegetation": StreetClass.VEGETATION,
    "building": StreetClass.BUILDING,
    "traffic_facility": StreetClass.POLE,
    "other_static": StreetClass.FENCE,
}
_OF_COARSE: Final = np.array([_STREET_CLASS[name] for name in COARSE], dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class FrameRange:
    """A range of frames of a log: from `first` up to, and without, `end`; None is the log's end."""

    first: int = 0
    end: int | None = None

    def __str__(self) -> str:
        """Return the range as `--frames` takes it."""
        return f"{self.first}:{'' if self.end is None else self.end}"


@dataclass(frozen=True, slots=True, eq=False)
class DriveFrame:
    """One frame of a drive: the answers of the parts, and the right labels.

    Attributes:
        index: Number of the frame in the drive, from 0.
        time_s: Seconds from the first frame of the drive.
        posed: The frame and its pose.
        predictive: Labels of the self-supervised stream.
        truth: Truth of its points.
        motion: (N,) right motion: 1 static, 2 dynamic; known at every point.
        class_id: (N,) right class, a `StreetClass`.
        track: (N,) object of each point, -1 none.
        ground: (N,) 1 on the ground.
        borders: Borders of its objects.
    """

    index: int
    time_s: float
    posed: PosedFrame
    predictive: FrameLabels
    truth: FrameTruth
    motion: NDArray[np.uint8]
    class_id: NDArray[np.uint8]
    track: NDArray[np.int16]
    ground: NDArray[np.uint8]
    borders: Borders

    @property
    def points_m(self) -> Points:
        """(N, 3) points in sensor space."""
        return self.posed.frame.points_m

    @property
    def world_from_sensor(self) -> Transform:
        """(4, 4) pose of the sensor, in odom space."""
        return self.posed.odom_from_sensor

    @property
    def seen(self) -> SeenFrame:
        """Points, objects and pose, on which label noise depends."""
        return SeenFrame(
            self.points_m,
            self.track.astype(np.int64),
            self.ground == 1,
            self.world_from_sensor,
            self.borders,
        )


@dataclass(frozen=True, slots=True)
class DriveActor:
    """An object of a drive.

    Attributes:
        street_class: Its class.
        size_m: Its longest side, metres, then zeros, which nothing reads; zeros where truth has no
            size.
    """

    street_class: StreetClass
    size_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """A drive, computed once for all its variants.

    Attributes:
        log_id: The log.
        shard: Its frames as one shard that starts with the first of them.
        frames: Its frames.
        scenes: First frame of each scene, and the frame after its last one.
        actors: Its objects, by the number that truth gives them.
        seed: Seed of the places of ghosts.
        nearest: Nearest points of neighbouring frames, for the baseline `flicker`.
    """

    log_id: str
    shard: Shard
    frames: tuple[DriveFrame, ...]
    scenes: tuple[tuple[int, int], ...]
    actors: tuple[DriveActor, ...]
    seed: int
    nearest: NearestPoints

    @property
    def period_s(self) -> float:
        """Median time between frames."""
        return float(np.median(np.diff([frame.time_s for frame in self.frames])))


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
    truth: LogTruth, read: Sequence[LidarFrame], frames: FrameRange
) -> list[FrameTruth]:
    """Read the truth of every frame of a drive.

    Raises:
        TruthUnusableError: If a frame has no truth of motion or no objects, or that of another log.
    """
    known = []
    for position, frame in enumerate(read, start=frames.first):
        true = truth.of(frame, number=truth.number_of(frame, position=position))
        if true is None or true.track is None:
            raise TruthUnusableError(
                f"{frame.log_id}, frame {position}: truth has no motion or no tracks; --plant "
                "needs both in every frame (deploy/TRUTH.md), --frames chooses those that have them"
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
    return Drive(
        recording.log_id,
        shard,
        tuple(known),
        scenes_of(shard, read),
        _actors(known),
        seed=0,
        nearest=NearestPoints(keeps=True),
    )


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
    class_id = _OF_COARSE[np.zeros(len(frame), np.uint8) if coarse is None else coarse]
    ground = np.isin(class_id, GROUND)
    if predictive.ground_mask is not None and coarse is None:
        ground = predictive.ground_mask
    return DriveFrame(
        index=number,
        time_s=time_s,
        posed=posed,
        predictive=predictive,
        truth=true,
        motion=_right_motion(true, track, ground),
        class_id=class_id,
        track=track,
        ground=ground.astype(np.uint8),
        borders=borders_of(frame.points_m, track),
    )


def _right_motion(true: FrameTruth, track: NDArray[np.int16], ground: Mask) -> NDArray[np.uint8]:
    """Return the labels of a model without errors, also where truth does not judge.

    There a point off the ground moves with the object it belongs to, and any other one is static.
    """
    motion = true.motion.copy()
    unknown = motion == TRUTH_UNKNOWN
    motion[unknown] = TRUTH_STATIC
    for each in np.unique(track[unknown & (track >= 0)]).tolist():
        mine = track == each
        counts = np.bincount(true.motion[mine], minlength=3)
        if counts[TRUTH_DYNAMIC] > counts[TRUTH_STATIC]:
            motion[mine & unknown & ~ground] = TRUTH_DYNAMIC
    return motion


def _actors(frames: Sequence[DriveFrame]) -> tuple[DriveActor, ...]:
    """List the objects of a drive: class by truth's name, else by most of their points."""
    count = max(int(frame.track.max(initial=-1)) for frame in frames) + 1
    votes = np.zeros((count, 256), np.int64)
    sides = np.zeros(count)
    names: dict[int, str] = {}
    for frame in frames:
        mine = frame.track >= 0
        np.add.at(votes, (frame.track[mine], frame.class_id[mine]), 1)
        for track, thing in frame.truth.objects.items():
            names.setdefault(track, thing.class_name)
            if 0 <= track < count and thing.longest_side_m is not None:
                sides[track] = thing.longest_side_m
    votes[:, StreetClass.OBJECT] = np.minimum(votes[:, StreetClass.OBJECT], 1)
    actors = []
    for track in range(count):
        named = _STREET_CLASS[COARSE[coarse_of_name(names.get(track, ""))]]
        most = StreetClass(int(votes[track].argmax()) or StreetClass.OBJECT)
        which = most if named is StreetClass.OBJECT else named
        actors.append(DriveActor(which, (float(sides[track]), 0.0, 0.0)))
    return tuple(actors)
