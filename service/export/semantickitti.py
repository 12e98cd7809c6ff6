"""Format `semantickitti`: a sequence for each scene, with pre-labels and the way back.

The layout is that of SemanticKITTI: `sequences/NN` with `velodyne`, `labels`, `poses.txt`,
`calib.txt` and `times.txt`. Points without a return are left out, since its tools divide by the
range; `index` gives the place of each point in the raw message. The upper half of a label is the
contradicting track of the point plus one, 0 without one.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from service.curation.selection import Selection
from service.export.classes import NAMES
from service.export.format import Format
from service.export.frames_file import frame_of, pose_from_first, write_frames, write_index
from service.export.points import LabelledCloud
from service.export.scene import SceneToExport

CAMERA_FROM_VELODYNE: Final = np.array(
    [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=np.float64
)
"""Axes of KITTI's camera (right, down, ahead) from those of a lidar (ahead, left, up).

SemanticKITTI's poses are those of its camera. Here the camera is at the place of the lidar."""

MAX_INSTANCE: Final = 65_535
"""Largest instance of a label: its upper 16 bits."""


def write_scene(scene: SceneToExport, folder: Path) -> None:
    """Write the sequence of one scene.

    Raises:
        PermanentError: If the log is gone, or no longer has the frames.
    """
    for name in ("velodyne", "labels"):
        (folder / name).mkdir(parents=True)
    first: LabelledCloud | None = None
    frames: list[dict[str, Any]] = []
    poses: list[str] = []
    times: list[str] = []
    for cloud in scene.clouds():
        first = first or cloud
        name = f"{cloud.number:06d}"
        points = np.column_stack([cloud.points_m, cloud.intensity]).astype("<f4")
        points.tofile(folder / "velodyne" / f"{name}.bin")
        labels_of(cloud).tofile(folder / "labels" / f"{name}.label")
        write_index(cloud, folder)
        poses.append(_row(camera_pose(pose_from_first(cloud, first))))
        times.append(f"{(cloud.stamp_ns - first.stamp_ns) / NS_PER_S:.6e}")
        frames.append(frame_of(cloud, scene))
    (folder / "poses.txt").write_text("".join(f"{line}\n" for line in poses))
    (folder / "times.txt").write_text("".join(f"{line}\n" for line in times))
    (folder / "calib.txt").write_text(_calibration())
    write_frames(scene, frames, folder)


def labels_of(cloud: LabelledCloud) -> NDArray[np.uint32]:
    """Return class and instance of each point in one word, as a `.label` file has them."""
    instance = np.clip(cloud.track + 1, 0, MAX_INSTANCE).astype(np.uint32)
    return (cloud.label | (instance << np.uint32(16))).astype("<u4")


def camera_pose(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a pose of the lidar as the pose of the camera at its place."""
    return CAMERA_FROM_VELODYNE @ pose @ np.linalg.inv(CAMERA_FROM_VELODYNE)


def write_names(_selection: Selection, _scenes: Sequence[SceneToExport], folder: Path) -> None:
    """Write the names of the classes in the form of `semantic-kitti.yaml`."""
    rows = "".join(f'  {number}: "{name}"\n' for number, name in NAMES.items())
    (folder / "labels.yaml").write_text(f"labels:\n{rows}")


def _calibration() -> str:
    camera = _row(np.eye(4))
    rows = [f"P{number}: {camera}" for number in range(4)]
    return "\n".join([*rows, f"Tr: {_row(CAMERA_FROM_VELODYNE)}"]) + "\n"


def _row(matrix: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.9e}" for value in matrix[:3].reshape(-1))


SEMANTICKITTI: Final = Format(
    name="semantickitti",
    text="SemanticKITTI sequences with pre-labels, moving classes, and an index to raw points.",
    folder="sequences",
    numbered=True,
    write_scene=write_scene,
    write_all=write_names,
    reads_logs=True,
)
"""Also what `import-labels` reads back."""
