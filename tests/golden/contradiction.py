"""Checks of which points contradict, and their instances."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points
from tests.golden.categories import categories
from tests.golden.difference import Difference, same
from tests.golden.files import Arrays, arrays
from tests.golden.fused_labels import is_dynamic_label
from workers.contradiction.agreement import compare
from workers.contradiction.instances import cluster_places
from workers.contradiction.settings import PAPER_INSTANCES


def check_discrepancy(folder: Path, file: Path) -> list[Difference]:
    """Compare categories and instances of made-up scenes."""
    del folder
    golden = arrays(file)
    supervised = is_dynamic_label(golden["supervised_semantic_motion_label"])
    return [
        same("supervised_binary", supervised, golden["supervised_binary"]),
        *compare_streams(golden, golden["points"], golden["self_supervised_motion"]),
    ]


def compare_streams(
    golden: Arrays, points_m: Points, dynamic: NDArray[np.integer | np.bool_]
) -> list[Difference]:
    """Compare categories and instances of one frame, given what the self-supervised stream says."""
    supervised = is_dynamic_label(golden["supervised_semantic_motion_label"])
    found = categories(compare(supervised.astype(np.uint8), dynamic.astype(np.uint8)))
    differences = [same("category", found, golden["category"])]
    for category in (3, 4):
        instances = cluster_places(points_m[found == category], settings=PAPER_INSTANCES)
        name = f"instance_category{category}"
        differences.append(same(name, instances, golden[name]))
    return differences


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "discrepancy/*.npz": check_discrepancy,
}
