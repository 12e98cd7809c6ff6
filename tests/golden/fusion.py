"""Checks of the fusion of both networks to semantic motion labels."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from schemas.labels import MotionLabel
from tests.golden.difference import Difference, same
from tests.golden.files import arrays
from workers.supervised.fusion import fuse

KITTI360_MOVABLE = (24, 25, 26, 27, 28, 29, 30, 31, 32, 33, 43)


def check_fusion(folder: Path, file: Path) -> list[Difference]:
    """Compare which points are dynamic."""
    del folder
    golden = arrays(file)
    prefix = "kitti360_" if "kitti360_semantic" in golden else ""
    semantic, motion, fused = (golden[prefix + name] for name in ("semantic", "motion", "fused"))
    labels = fuse(
        judged_mask=np.ones(len(semantic), dtype=np.bool_),
        movable_mask=np.isin(semantic, KITTI360_MOVABLE),
        moving_mask=motion == 2,
    )
    return [same("dynamic", labels == MotionLabel.DYNAMIC, fused >= 200)]


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "fusion/*.npz": check_fusion,
}
