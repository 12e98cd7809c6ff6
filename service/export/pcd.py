"""Formats `cvat` and `xtreme1`: binary PCD of each frame with intensity and pre-label.

CVAT takes the folder `pointcloud` of a scene, Xtreme1 its folder `lidar_point_cloud_0`. The field
`index` is the place of a point in the raw message.
"""

from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from service.export.format import Format
from service.export.frames_file import frame_of, write_frames, write_index
from service.export.points import LabelledCloud
from service.export.scene import SceneToExport

CVAT_CLOUDS: Final = "pointcloud"
XTREME1_CLOUDS: Final = "lidar_point_cloud_0"
"""Folders of the clouds of a scene, as each tool names them."""

_FIELDS: Final = (
    ("x", "<f4"),
    ("y", "<f4"),
    ("z", "<f4"),
    ("intensity", "<f4"),
    ("label", "<u4"),
    ("index", "<u4"),
)
_KINDS: Final = {"f": "F", "u": "U", "i": "I"}


def write_scene(scene: SceneToExport, folder: Path, *, clouds: str) -> None:
    """Write the frames of one scene.

    Args:
        scene: The scene.
        folder: Folder of the scene.
        clouds: Folder of its point clouds, as the tool names it.

    Raises:
        PermanentError: If the log is gone, or no longer has the frames.
    """
    (folder / clouds).mkdir(parents=True)
    frames: list[dict[str, Any]] = []
    for cloud in scene.clouds():
        (folder / clouds / f"{cloud.number:06d}.pcd").write_bytes(pcd(cloud))
        write_index(cloud, folder)
        frames.append(frame_of(cloud, scene))
    write_frames(scene, frames, folder)


def pcd(cloud: LabelledCloud) -> bytes:
    """Return a frame as PCD 0.7, binary and not compressed."""
    points = np.empty(len(cloud), dtype=list(_FIELDS))
    for axis, name in enumerate("xyz"):
        points[name] = cloud.points_m[:, axis]
    points["intensity"], points["label"] = cloud.intensity, cloud.label
    points["index"] = cloud.raw_index
    names = [name for name, _ in _FIELDS]
    kinds = [np.dtype(kind) for _, kind in _FIELDS]
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(str(kind.itemsize) for kind in kinds)}",
        f"TYPE {' '.join(_KINDS[kind.kind] for kind in kinds)}",
        f"COUNT {' '.join('1' for _ in kinds)}",
        f"WIDTH {len(points)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(points)}",
        "DATA binary",
    ]
    return ("\n".join(header) + "\n").encode("ascii") + points.tobytes()


CVAT: Final = Format(
    name="cvat",
    text="Binary PCD with intensity and pre-label in the folders of CVAT's 3D tasks.",
    write_scene=partial(write_scene, clouds=CVAT_CLOUDS),
    reads_logs=True,
)
"""Also read by any program that reads PCD."""

XTREME1: Final = Format(
    name="xtreme1",
    text="The same PCD in the folders of Xtreme1.",
    write_scene=partial(write_scene, clouds=XTREME1_CLOUDS),
    reads_logs=True,
)
"""Xtreme1 reads PCD alone."""
