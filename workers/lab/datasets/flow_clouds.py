"""Clouds with their poses for scene flow, as the two-stage stream gives them to a flow."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from schemas.arrays import Points, Transform
from schemas.frame import OdometryState, PosedFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from workers.lab.datasets.frame_files import (
    Numbered,
    chosen,
    made_once,
    street_clouds,
    stretch_frames,
)
from workers.lab.datasets.learnt_clouds import Stretch
from workers.lab.simulation.sensor.sensors import SensorName
from workers.lidar.preprocessing import Preprocessor
from workers.paper.learned_flow import REACH_M
from workers.parts.registry import build_odometry
from workers.points.se3 import inverse, transform

FEWEST_POINTS: Final = 256
"""Voxels off the ground that a cloud needs; fewer have no shape."""

_NEAR_M: Final = REACH_M + 5.0
"""Largest |x| and |y| of points that are kept, metres: what ego-motion may bring into reach."""


@dataclass(frozen=True, slots=True, eq=False)
class FlowCloud:
    """Voxels off the ground of one frame, with its pose.

    Attributes:
        points_m: (N, 3) float32 about the origin of the beams, metres.
        odom_from_points: (4, 4) pose.
    """

    points_m: Points
    odom_from_points: Transform

    @classmethod
    def of(cls, posed: PosedFrame, prepare: Preprocessor) -> "FlowCloud | None":
        """Preprocess a frame; None where it has too few points, or no pose that can be trusted."""
        if posed.odometry is OdometryState.LOST:
            return None
        prepared = prepare(posed.frame, posed.odom_from_sensor, None)
        if prepared is None:
            return None
        points = transform(prepared.beams_from_odom, prepared.voxels.centroids_m)
        points = points[(np.abs(points[:, :2]) < _NEAR_M).all(axis=1)].astype(np.float32)
        return cls(points, prepared.odom_from_beams) if len(points) >= FEWEST_POINTS else None

    @classmethod
    def read(cls, path: Path) -> "FlowCloud":
        """Read a cloud that this file wrote."""
        with np.load(path) as stored:
            return cls(stored["points_m"], stored["odom_from_points"])

    def write(self, path: Path) -> None:
        """Write the cloud to an `.npz` file."""
        np.savez(path, points_m=self.points_m, odom_from_points=self.odom_from_points)

    def before(self, following: "FlowCloud") -> tuple[Points, Points]:
        """Return both clouds within reach in the space of the second; ego-motion is removed."""
        moved = inverse(following.odom_from_points) @ self.odom_from_points
        clouds = (transform(moved, self.points_m).astype(np.float32), following.points_m)
        first, second = (each[(np.abs(each[:, :2]) < REACH_M).all(axis=1)] for each in clouds)
        return first, second


def clouds_of_stretch(
    folder: Path,
    bucket: Bucket,
    stretch: Stretch,
    settings: MiningSettings,
    *,
    on_frame: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write the clouds of a stretch of a log, or list those of an earlier run, in order of time.

    Args:
        folder: Folder of these clouds alone.
        bucket: Bucket of the log.
        stretch: The stretch.
        settings: Ingest settings, and the odometry that poses the clouds.
        on_frame: Called with each frame.
    """

    def build() -> Numbered:
        prepare = Preprocessor()
        posed_frames = build_odometry(settings.odometry)(stretch_frames(bucket, stretch, settings))
        for number, posed in chosen(posed_frames, stretch, on_frame):
            yield number, FlowCloud.of(posed, prepare)

    return made_once(folder, build)


def clouds_of_streets(
    folder: Path,
    *,
    streets: int,
    sensors: Sequence[SensorName],
    seed: int,
    columns: int | None = None,
    on_window: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write clouds of simulated streets, or list those of an earlier run; their poses are true."""

    def build() -> Numbered:
        for first, clouds in street_clouds(
            streets=streets, sensors=sensors, seed=seed, columns=columns, on_window=on_window
        ):
            prepare = Preprocessor()
            for number, cloud in enumerate(clouds, start=first):
                posed = PosedFrame(cloud.frame, cloud.world_from_sensor)
                yield number, FlowCloud.of(posed, prepare)

    return made_once(folder, build) if streets else []
