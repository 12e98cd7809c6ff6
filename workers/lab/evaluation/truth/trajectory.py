"""Trajectories of truth: poses over time, interpolated at the times of points and frames."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from schemas.arrays import NS_PER_S, Transform
from schemas.transport.recordings import EXTENSION
from schemas.work import Recording


class Trajectory:
    """Poses over time, linear in between; the first and last one count beyond the ends.

    Args:
        times_ns: (F,) rising times.
        poses: (F, 4, 4) poses.
    """

    def __init__(self, times_ns: Sequence[int], poses: Sequence[Transform]) -> None:
        self._origin_ns = int(times_ns[0])
        times = np.asarray(times_ns, np.int64)
        self._seconds = (times - self._origin_ns) / NS_PER_S
        self._poses = np.asarray(poses, np.float64).reshape(-1, 4, 4)
        rotations = Rotation.from_matrix(self._poses[:, :3, :3])
        self._slerp = Slerp(self._seconds, rotations) if len(times) > 1 else None

    def at(self, times_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the poses at some times, (T, 4, 4)."""
        seconds = (np.asarray(times_ns, np.int64) - self._origin_ns) / NS_PER_S
        seconds = np.clip(seconds, self._seconds[0], self._seconds[-1])
        poses = np.tile(np.eye(4), (len(seconds), 1, 1))
        if self._slerp is None:
            poses[:] = self._poses[0]
            return poses
        poses[:, :3, :3] = self._slerp(seconds).as_matrix()
        for axis in range(3):
            poses[:, axis, 3] = np.interp(seconds, self._seconds, self._poses[:, axis, 3])
        return poses

    def at_each(self, times_ns: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return the poses at the distinct times, (U, 4, 4), and which of them each time has."""
        distinct, which = np.unique(times_ns, return_inverse=True)
        return self.at(distinct), which


def applied(
    poses: NDArray[np.float64], which: NDArray[np.intp], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Map each point by its own pose."""
    moved: NDArray[np.float64] = np.einsum("nij,nj->ni", poses[which, :3, :3], points)
    return moved + poses[which, :3, 3]


def unapplied(
    poses: NDArray[np.float64], which: NDArray[np.intp], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Map each point by the inverse of its own pose."""
    apart = points - poses[which, :3, 3]
    back: NDArray[np.float64] = np.einsum("nji,nj->ni", poses[which, :3, :3], apart)
    return back


TRUE_POSES: Final = "poses.npz"
ICP_POSES: Final = "poses_icp.npz"
"""Poses by registration, which are no ground truth."""


class LogTrajectory(NamedTuple):
    """Poses of the sensor over a whole log.

    Attributes:
        times_ns: (F,) rising stamps.
        poses: (F, 4, 4) world from sensor at the stamps.
        is_truth: False where the poses come of registration.
    """

    times_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    is_truth: bool

    def interpolated(self) -> Trajectory:
        """Return the poses at any time."""
        return Trajectory(self.times_ns.tolist(), list(self.poses))


def trajectory_of(recording: Recording, truth: Path) -> LogTrajectory | None:
    """Read the poses of a log from the folders of its parts; None where there are none.

    Those of `poses_icp.npz` are read where there is no `poses.npz`. The parts of a split recording
    have one world.
    """
    folders = [truth / part.key.removesuffix(EXTENSION) for part in recording.parts]
    if not any(folder.is_dir() for folder in folders):
        folders = [truth / recording.log_id]
    for name, poses_name in (
        (TRUE_POSES, "world_from_lidar_at_stamp"),
        (ICP_POSES, "world_from_lidar"),
    ):
        files = [folder / name for folder in folders if (folder / name).is_file()]
        if not files:
            continue
        loaded = [np.load(file) for file in files]
        times_ns = np.concatenate([each["stamp_ns"] for each in loaded]).astype(np.int64)
        poses = np.concatenate([each[poses_name] for each in loaded])
        order = np.unique(times_ns, return_index=True)[1]
        if len(order) < 2:
            continue
        return LogTrajectory(times_ns[order], poses[order], name == TRUE_POSES)
    return None
