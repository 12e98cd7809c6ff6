"""Logs of a data set as its reader yields them: frames, poses, boxes, cameras, classes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Transform
from schemas.errors import PermanentError
from workers.lab.datasets.conversion.boxes import TrackRow


class DatasetUnusableError(PermanentError):
    """A folder is not the data set that it should be, or one of its files is damaged."""


@dataclass(frozen=True, slots=True)
class ClassRow:
    """One class of a data set: a row of `classes.json`.

    Attributes:
        class_id: Id in the files of the data set.
        name: Its own name there.
        semantickitti19: Number of the class of SemanticKITTI; 0 none.
        movable: Whether such an object can move.
        is_ground: Whether it is a surface to drive or walk on.
        noise: Whether its points are no object: exhaust, spray, reflections.
        label: Id in SemanticKITTI's `.label` files.
    """

    class_id: int
    name: str
    semantickitti19: int
    movable: bool = False
    is_ground: bool = False
    noise: bool = False
    label: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class CameraModel:
    """A camera of the car.

    Attributes:
        name: Part of its topics, `/camera/NAME/…`.
        width: Pixels.
        height: Pixels.
        intrinsics: (3, 3) K.
        distortion: Coefficients of the lens; zero for rectified images.
        distortion_model: ROS's name.
        lidar_from_camera: (4, 4) pose of the camera in sensor space; z along its view.
    """

    name: str
    width: int
    height: int
    intrinsics: NDArray[np.float64]
    lidar_from_camera: Transform
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    distortion_model: str = "plumb_bob"

    @property
    def space(self) -> str:
        """Name of its coordinate system."""
        return f"camera_{self.name}_optical"


@dataclass(frozen=True, slots=True)
class Picture:
    """One image: its camera, its time in nanoseconds since the Unix epoch, and its file."""

    camera: str
    stamp_ns: int
    path: Path


@dataclass(frozen=True, slots=True, eq=False)
class SourceFrame:
    """One frame of a data set: N points, and what is known of them.

    Attributes:
        stamp_ns: Nanoseconds since the Unix epoch.
        rows: (N,) structured, the fields of the PointCloud2: x, y, z, intensity, perhaps times.
        world_from_sensor: (4, 4) pose at the stamp; None where the data set has none.
        truth: Arrays of `deploy/TRUTH.md` by name, each (N, …); empty where it has none.
        tracks: Objects of the frame.
        pictures: Images that belong to the frame.
        label_ids: (N,) classes as SemanticKITTI's `.label` files write them; None without classes.
    """

    stamp_ns: int
    rows: NDArray[Any]
    world_from_sensor: Transform | None = None
    truth: dict[str, NDArray[Any]] = field(default_factory=dict)
    tracks: Sequence[TrackRow] = ()
    pictures: Sequence[Picture] = ()
    label_ids: NDArray[np.uint32] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SourceLog:
    """One drive of a data set; its frames are read while they are written.

    Attributes:
        name: Name of the log.
        vehicle: Name of the car.
        date: Day of the recording, `YYYY-MM-DD`.
        topic: Topic of the lidar.
        space: Coordinate system of its points.
        length: Number of frames.
        frames: Reads the frames, in order.
        classes: Classes of the array `semantic`; empty where there is no such array.
        cameras: Cameras whose images are written.
        base_from_lidar: (4, 4) mounting of the lidar on the car; None where not known.
        notes: Sentences about what truth and times mean, for the user.
    """

    name: str
    vehicle: str
    date: str
    topic: str
    space: str
    length: int
    frames: Callable[[], Iterator[SourceFrame]]
    classes: tuple[ClassRow, ...] = ()
    cameras: tuple[CameraModel, ...] = ()
    base_from_lidar: Transform | None = None
    notes: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Key of the log in a bucket, without `.mcap`."""
        return f"{self.vehicle}/{self.date}/{self.name}"
