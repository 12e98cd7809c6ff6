"""Small labelled worlds: boxes of points, each with what both streams say of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.contradiction import Instance, LabelledFrame, Scene
from schemas.frame import LidarFrame, OdometryState, PosedFrame
from schemas.labels import FrameLabels
from schemas.task import MOTION, Task
from schemas.work import Channel, Shard
from workers.contradiction.agreement import compare
from workers.contradiction.attribution import attribute_tracks
from workers.contradiction.feature_extraction import extract_features
from workers.contradiction.track_score import RankedTrack, rank_tracks
from workers.contradiction.tracks import associate_instances

START_NS = 1_700_000_000_000_000_000
CLASS_NAMES = ("building", "car", "pedestrian")


@dataclass(frozen=True)
class Thing:
    """A box of points in odom space that moves steadily, and both streams' opinion of it."""

    at_m: tuple[float, float, float]
    semantic: int
    predictive: int
    size_m: tuple[float, float, float] = (4.0, 1.8, 1.5)
    points: int = 120
    velocity_m_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    measured: bool = True
    class_id: int = 1
    confidence: float = 0.9
    ground: bool = False
    frames: frozenset[int] | None = None
    confirmed_share: float | None = None

    def placed(self, time_s: float) -> NDArray[np.float32]:
        """Its points at a time; the same ones in every frame."""
        rng = np.random.default_rng(len(str(self.at_m)) + self.points)
        inside = rng.uniform(-0.5, 0.5, (self.points, 3)) * np.array(self.size_m)
        centre = np.array(self.at_m) + time_s * np.array(self.velocity_m_per_s)
        return np.asarray(inside + centre, dtype=np.float32)


def labelled_frame(
    things: Sequence[Thing],
    *,
    frame: int = 0,
    time_s: float = 0.0,
    odom_from_sensor: NDArray[np.float64] | None = None,
    odometry: OdometryState = OdometryState.HEALTHY,
    ground: bool = True,
    classes: bool = True,
    task: Task = MOTION,
) -> LabelledFrame:
    """Put things into one frame, in the order given."""
    pose = np.eye(4) if odom_from_sensor is None else odom_from_sensor
    shown = [t for t in things if t.frames is None or frame in t.frames]
    counts = [t.points for t in shown]
    total = sum(counts)
    odom_m = np.concatenate([np.zeros((0, 3)), *(t.placed(time_s) for t in shown)])
    points_m = ((odom_m - pose[:3, 3]) @ pose[:3, :3]).astype(np.float32)

    def each(values: Sequence[float], dtype: type) -> NDArray[Any]:
        return np.repeat(np.array(values, dtype=dtype), counts)

    confidence = each([t.confidence for t in shown], np.float16)
    semantic = FrameLabels(
        labels=each([t.semantic for t in shown], np.uint8),
        confidence=confidence,
        class_id=each([t.class_id for t in shown], np.int16) if classes else None,
    )
    speeds = [t.velocity_m_per_s if t.measured else (0.0, 0.0, 0.0) for t in shown]
    predictive = FrameLabels(
        labels=each([t.predictive for t in shown], np.uint8),
        confidence=confidence,
        ground_mask=each([t.ground for t in shown], np.bool_) if ground else None,
        cluster=each(list(range(len(shown))), np.int32),
        cluster_velocity_m_per_s=np.array(speeds, dtype=np.float32).reshape(-1, 3),
        confirmed=_confirmed(shown),
    )
    lidar = LidarFrame(
        log_id="fleet/car-1/drive",
        stamp_ns=START_NS + round(time_s * 1e9),
        points_m=points_m,
        intensity=np.zeros(total, dtype=np.float32),
        offset_ns=np.zeros(total, dtype=np.int32),
        ring=np.full(total, -1, dtype=np.int16),
        valid_mask=np.ones(total, dtype=np.bool_),
    )
    return LabelledFrame(
        posed=PosedFrame(lidar, pose, odometry, 0.03, "" if odometry == "healthy" else "a bump"),
        semantic=semantic,
        predictive=predictive,
        agreements=compare(semantic.labels, predictive.labels, task),
        task=task,
    )


def _confirmed(things: Sequence[Thing]) -> NDArray[np.bool_] | None:
    """The first so many points of each thing; None where no thing says."""
    if all(thing.confirmed_share is None for thing in things):
        return None
    return np.concatenate(
        [np.arange(t.points) < (t.confirmed_share or 0.0) * t.points for t in things]
    )


def labelled_scene(
    things: Sequence[Thing],
    *,
    frames: int = 20,
    period_s: float = 0.1,
    ego_m_per_s: float = 0.0,
    odometry: Sequence[OdometryState] = (),
    too_short: bool = False,
    task: Task = MOTION,
) -> Scene:
    """Put things into the frames of a scene, the sensor driving straight ahead."""
    made = []
    for frame in range(frames):
        pose = np.eye(4)
        pose[0, 3] = ego_m_per_s * frame * period_s
        made.append(
            labelled_frame(
                things,
                frame=frame,
                time_s=frame * period_s,
                odom_from_sensor=pose,
                odometry=odometry[frame] if odometry else OdometryState.HEALTHY,
                task=task,
            )
        )
    return Scene(f"fleet/car-1/drive/lidar/{START_NS}", tuple(made), too_short=too_short)


def shard_of(log_id: str = "fleet/car-1/drive") -> Shard:
    """Return a shard that scenes may be said to be cut from."""
    lidar = Channel(
        topic="/lidar",
        message_encoding="cdr",
        schema_name="sensor_msgs/msg/PointCloud2",
        schema_encoding="ros2msg",
        schema_base64="",
        ids=((0, 1),),
    )
    return Shard(
        log_id=log_id,
        index=0,
        lidar=lidar,
        anchor_ns=START_NS,
        warmup_start_ns=START_NS,
        start_ns=START_NS,
        end_ns=START_NS + 20_000_000_000,
        lookahead_end_ns=START_NS + 20_000_000_000,
        chunks=(),
        needed_bytes=0,
        vehicle="car-1",
        date="2023-11-14",
        software_version="7.1",
    )


def ranked_tracks(scene: Scene, instances: Sequence[Instance]) -> tuple[RankedTrack, ...]:
    """Associate, describe, attribute and rank the instances of a scene, as `mine_shard` does."""
    described = extract_features(scene, instances, associate_instances(scene, instances))
    return rank_tracks(scene, described, attribute_tracks(described))
