"""Checks of the two-stage clustering that turns flow into motion labels."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from tests.golden.difference import Difference, same
from tests.golden.files import arrays
from workers.selfsupervised.two_stage_clustering import PAPER, two_stage


def check_synthetic(folder: Path, file: Path) -> list[Difference]:
    """Compare both stages on made-up scenes."""
    del folder
    golden = arrays(file)
    kept = golden["kept_x_below_25"]
    flow_m = golden["points_plus_relative_flow"] - golden["points"]
    found = two_stage(golden["points"][kept], flow_m[kept], dt_s=float(golden["dt_s"]), rule=PAPER)
    return [
        same("stage1_cluster", found.first_cluster, golden["stage1_cluster"]),
        same("stage1_potentially_dynamic", found.candidate, golden["stage1_potentially_dynamic"]),
        same("stage2_cluster", found.second_cluster, golden["stage2_cluster"]),
        same("motion_label", found.dynamic, golden["motion_label"]),
    ]


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "motion/synthetic_*.npz": check_synthetic,
}
