"""A real drive with truth, and the answers of the parts that planted labels do not change."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points, Transform
from schemas.frame import PosedFrame
from schemas.labels import FrameLabels
from schemas.work import Shard
from workers.lab.evaluation.failures.nearest_points import NearestPoints
from workers.lab.evaluation.truth.truth import FrameTruth
from workers.lab.labels.borders import Borders
from workers.lab.labels.noise_settings import SeenFrame
from workers.lab.simulation.faults.detected_boxes import Body
from workers.lab.simulation.models.kinds import StreetClass


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
        bodies: True boxes that a detector looks for, odom space, by object.
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
    bodies: Mapping[int, Body] = field(default_factory=dict)

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
