"""Reader of PandaSet logs with their truth: classes, motion and poses."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from schemas.arrays import NS_PER_S, Transform
from schemas.frame import LidarFrame
from schemas.mining import Grid, MiningSettings
from schemas.runtime.real_path import real_path
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import recording_of
from workers.errors import LogUnusableError
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.lab.datasets.classes import CLASSES
from workers.lab.datasets.images import Cloud

_PANDASET_IDS: Final[Mapping[str, tuple[int, ...]]] = {
    "car": (13, 14),
    "large_vehicle": (15, 16, 17, 19, 20, 22, 23, 27, 28, 29),
    "two_wheeler": (18, 21, 24, 25, 26),
    "pedestrian": (30, 31),
    "road": (7, 8, 9, 10),
    "sidewalk": (11, 12),
    "other_ground": (6,),
    "vegetation": (5,),
    "building": (41,),
    "traffic_facility": (34, 35, 36, 37, 38, 39),
    "other_static": (40, 42),
}
"""PandaSet's ids of each class; noise (1 to 4) and animals (32, 33) stay unlabelled."""

SWEEP_S: Final = 0.1029
"""Duration of one revolution, seconds."""


def read_clouds(log: Path, truth: Path, frames: range) -> Iterator[Cloud]:
    """Read frames of the log with their truth, in order.

    Args:
        log: The MCAP file.
        truth: Folder with `NNNNNN.npz` per frame and `poses.npz`.
        frames: Numbers of the frames.

    Yields:
        One cloud per frame of `frames`.

    Raises:
        LogUnusableError: If the log cannot be read.
    """
    class_of = np.zeros(256, dtype=np.uint8)
    for class_id, (name, _) in enumerate(CLASSES):
        class_of[list(_PANDASET_IDS.get(name, ()))] = class_id
    poses = np.load(truth / "poses.npz")
    times_ns, at_reference = poses["reference_time_ns"], poses["world_from_lidar_at_reference"]
    for number, frame in enumerate(_frames(log)):
        if number not in frames:
            continue
        labels = np.load(truth / f"{number:06d}.npz")
        own = labels["ego"] == 1
        middle_ns = frame.stamp_ns + round(SWEEP_S / 2 * NS_PER_S)
        yield Cloud(
            frame,
            semantic=np.where(own, np.uint8(0), class_of[labels["semantic"]]),
            motion=np.where(own, np.uint8(0), labels["motion"]),
            world_from_sensor=_pose_at(middle_ns, times_ns, at_reference),
        )


def _frames(log: Path) -> Iterator[LidarFrame]:
    """Yield the frames of one file, decoded as in a worker: one shard contains the whole log."""
    bucket = open_bucket(str(real_path(log).parent))
    try:
        recording = recording_of(log.name, bucket.list())
    except LookupError:
        raise LogUnusableError(f"cannot train on {log}: there is no such file") from None
    settings = MiningSettings(
        bucket=bucket.url, artifacts="memory://", grid=Grid(shard_s=3600.0, warmup_s=0.0)
    )
    plan = plan_recording(bucket, recording, settings)
    if plan.refused:
        raise LogUnusableError(f"cannot train on {log.name}: {plan.refused}")
    for shard in plan.shards:
        yield from read_shard(bucket, recording, shard, settings).frames()


def _pose_at(time_ns: int, times_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> Transform:
    """Interpolate a trajectory; beyond its ends, the first or last pose is used."""
    seconds = (times_ns - times_ns[0]) / NS_PER_S
    at = float(np.clip((time_ns - times_ns[0]) / NS_PER_S, seconds[0], seconds[-1]))
    pose: Transform = np.eye(4)
    pose[:3, :3] = Slerp(seconds, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
    pose[:3, 3] = [np.interp(at, seconds, poses[:, axis, 3]) for axis in range(3)]
    return pose
