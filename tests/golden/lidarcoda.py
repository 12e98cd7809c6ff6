"""Checks of LidarCODA: points in boxes, both clusterings and the labels of every grade."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from tests.golden.difference import Difference, near, same
from tests.golden.files import arrays
from workers.lab.lidarcoda.cameras import linear_camera
from workers.lab.lidarcoda.clustering import cluster_box
from workers.lab.lidarcoda.grades import Grade, object_labels

TOLERANCE_M: Final = 1e-5


def check_frustum(folder: Path, file: Path) -> list[Difference]:
    """Compare coordinates, labels, choices and graded labels of every box of a frame."""
    del folder
    golden = arrays(file)
    projection, rotation, camera = (np.eye(4) for _ in range(3))
    projection[:3], rotation[:3, :3], camera[:3] = (
        *(golden["P2"], golden["R0_rect"]),
        golden["Tr_velo_to_cam"],
    )
    seen = linear_camera(projection @ rotation @ camera, ahead_of_lidar=True)(
        golden["points"][:, :3].astype(np.float64)
    )
    found = []
    for place, box_px in enumerate(golden["boxes_xywh"]):
        left, top, width, height = (float(value) for value in box_px)
        box = cluster_box(seen, (left, top, width, height))
        expected = golden[f"box{place}_output"]
        found += [
            near(f"box {place} xyz", box.columns[:, :3], expected[:, :3], tolerance=TOLERANCE_M),
            same(f"box {place} clusters", box.columns[:, 3:], expected[:, 3:]),
            same(
                f"box {place} grades",
                np.stack([object_labels(box, grade) for grade in Grade]),
                golden[f"box{place}_label_for_grade_1_to_9"],
            ),
        ]
    return found


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "lidarcoda/frustum_*.npz": check_frustum
}
