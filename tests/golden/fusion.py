"""Checks of the fusion of both networks to semantic motion labels."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.labels import MotionLabel
from tests.golden.difference import Difference, same
from tests.golden.files import arrays
from tests.golden.fused_labels import (
    KITTI360_MOVABLE,
    MOVING_CLASS,
    is_dynamic_label,
    semantic_kitti_motion,
    semantic_motion_labels,
)
from workers.supervised.fusion import fuse


def check_arrays(folder: Path, file: Path) -> list[Difference]:
    """Compare all combinations of ids, of KITTI-360 and of SemanticKITTI."""
    del folder
    golden = arrays(file)
    combined = semantic_kitti_motion(
        golden["semantickitti_semantic"], golden["semantickitti_motion"]
    )
    return [
        *_fused(*(golden[f"kitti360_{name}"] for name in ("semantic", "motion", "fused"))),
        same("semantickitti_combined", combined, golden["semantickitti_combined"]),
    ]


def check_frame(folder: Path, file: Path) -> list[Difference]:
    """Compare a whole frame."""
    del folder
    golden = arrays(file)
    return _fused(golden["semantic"], golden["motion"], golden["fused"])


def _fused(
    semantic: NDArray[Any], motion: NDArray[Any], expected: NDArray[Any]
) -> list[Difference]:
    """Compare the published ids, and the labels that our stream gives instead."""
    labels = fuse(
        judged_mask=np.ones(len(semantic), dtype=np.bool_),
        movable_mask=np.isin(semantic, KITTI360_MOVABLE),
        moving_mask=motion == MOVING_CLASS,
    )
    return [
        same("fused", semantic_motion_labels(semantic, motion), expected),
        same("dynamic", labels == MotionLabel.DYNAMIC, is_dynamic_label(expected)),
    ]


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "fusion/arrays.npz": check_arrays,
    "fusion/kitti360_*.npz": check_frame,
}
