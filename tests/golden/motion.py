"""Checks of the two-stage clustering that turns flow into motion labels, and of its chain."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from schemas.motion_rule import KMH, PAPER
from tests.golden.contradiction import compare_streams
from tests.golden.difference import Difference, near, relative, same
from tests.golden.files import Arrays, arrays, number_of
from tests.golden.geometry import calibration_of
from workers.paper.camera_filter import is_ahead_within
from workers.paper.object_flow import flow_ends
from workers.paper.two_stage_clustering import ClusterSpeed, TwoStageResult, two_stage


def check_synthetic(folder: Path, file: Path) -> list[Difference]:
    """Compare both stages on made-up scenes."""
    del folder
    golden = arrays(file)
    points, ends = golden["points"], golden["points_plus_relative_flow"]
    kept = is_ahead_within(points)
    return [
        same("kept_x_below_25", kept, golden["kept_x_below_25"]),
        *_stages(golden, _label(golden, points[kept], ends[kept])),
    ]


def check_chain(folder: Path, file: Path) -> list[Difference]:
    """Compare a real frame: from flow over ego-motion and clustering to contradictions."""
    golden = arrays(file)
    filtered = arrays(folder / "geometry" / f"camera_filter_{number_of(file):06d}.npz")
    points = filtered["points_lidar_frame"]
    kept = is_ahead_within(points)
    ends = flow_ends(
        filtered["points_flow_frame"],
        golden["flow"],
        calibration_of(folder),
        golden["transformation_next_to_current"],
    )
    found = _label(golden, points[kept], ends[kept])
    return [
        near(
            "points_plus_relative_flow", ends, golden["points_plus_relative_flow"], tolerance=5e-6
        ),
        *_stages(golden, found),
        *compare_streams(golden, points[kept], found.dynamic),
    ]


def _label(golden: Arrays, points: NDArray[Any], ends: NDArray[Any]) -> TwoStageResult:
    return two_stage(points, ends - points, dt_s=float(golden["dt_s"]), rule=PAPER)


def _stages(golden: Arrays, found: TwoStageResult) -> list[Difference]:
    return [
        same("stage1_cluster", found.first_cluster, golden["stage1_cluster"]),
        same("stage1_potentially_dynamic", found.candidate, golden["stage1_potentially_dynamic"]),
        _table("stage1_table", found.first_speeds, golden["stage1_table"], range(6)),
        same("stage2_cluster", found.second_cluster, golden["stage2_cluster"]),
        _table("stage2_table", found.second_speeds, golden["stage2_table"], (0, 1, 3, 4, 5)),
        same("motion_label", found.dynamic, golden["motion_label"]),
    ]


def _table(
    name: str, speeds: Sequence[ClusterSpeed], expected: NDArray[Any], columns: Sequence[int]
) -> Difference:
    rows = [
        (
            each.cluster,
            each.points,
            each.judged_points,
            each.median_m_per_s / KMH,
            each.spread,
            each.moves,
        )
        for each in speeds
    ]
    found = np.array(rows, np.float64).reshape(-1, 6)[:, list(columns)]
    return relative(name, found, expected, tolerance=1e-6)


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "motion/synthetic_*.npz": check_synthetic,
    "chain/*.npz": check_chain,
}
