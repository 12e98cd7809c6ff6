"""Checks of the evaluation measures of the paper."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from tests.golden.difference import Difference, near, same
from tests.golden.files import arrays, document
from workers.lab.lidarcoda.matching import COLUMNS, match_points, sums_of
from workers.lab.lidarcoda.measures import (
    Averaging,
    Measures,
    PointSet,
    paper_measures,
)
from workers.lidar.fidelity import Form

TOLERANCE: Final = 1e-12


def check_measures(folder: Path, file: Path) -> list[Difference]:
    """Compare every measure of every variant of every table, and the sums of the tables."""
    del folder
    golden, listed = arrays(file), document(file.with_name("metrics.json"))
    found = [same("columns", list(COLUMNS), listed["columns"])]
    for table, about in listed["tables"].items():
        counts = golden[table]
        found.append(same(f"{table} sums", sums_of(counts[:, :14]), counts[:, 14:20]))
        for clustered, variants in about["results"].items():
            for averaging, sets in variants.items():
                measured = {
                    points: paper_measures(
                        counts,
                        PointSet(points),
                        clustered=clustered == "clustered",
                        averaging=Averaging(averaging),
                        form=Form.PAPER,
                    )
                    for points in sets
                }
                found += _compare(f"{table} {clustered} {averaging}", measured, sets)
    return found


def _compare(
    what: str, measured: Mapping[str, Measures], expected: Mapping[str, Mapping[str, Any]]
) -> list[Difference]:
    """Compare one variant over all its sets of points, number by number."""
    found: dict[tuple[str, str], Any] = {}
    wanted: dict[tuple[str, str], Any] = {}
    for points, values in expected.items():
        measures = measured[points]
        ours: dict[str, Any] = {
            "n": measures.n,
            "mIoU": measures.mean_iou,
            "IoU": measures.mean_iou,
            "AP": measures.average_precision,
            "AR": measures.average_recall,
            "F1": measures.f1,
            "mean_confusion_ratios_tp_fp_fn_tn": measures.ratios,
            "confusion_ratios_tp_fp_fn_tn": measures.ratios,
        }
        for name, value in values.items():
            found[points, name], wanted[points, name] = ours[name], value
    counted = [key for key in wanted if key[1] == "n"]
    ratios = [key for key in wanted if key[1] != "n"]
    return [
        same(f"{what} n", [found[key] for key in counted], [wanted[key] for key in counted]),
        near(
            what,
            np.hstack([found[key] for key in ratios]),
            np.hstack([wanted[key] for key in ratios]),
            tolerance=TOLERANCE,
        ),
    ]


def check_matching(folder: Path, file: Path) -> list[Difference]:
    """Compare which true point is which labelled point, and what is counted of them."""
    del folder
    golden = arrays(file)
    found = match_points(
        golden["ground_truth_xyz_label"],
        golden["method_xyz"],
        golden["method_category"],
        form=Form.PAPER,
    )
    return [
        near("combined_points", found.points_m, golden["combined_points"], tolerance=0.0),
        same("combined_code", found.code, golden["combined_code"]),
        same("counts", found.counts(), golden["counts"]),
        same("annotation_level_code", found.annotation_code(), golden["annotation_level_code"]),
        same(
            "annotation_level_counts", found.annotation_counts(), golden["annotation_level_counts"]
        ),
    ]


CHECKS: Final[Mapping[str, Callable[[Path, Path], list[Difference]]]] = {
    "metrics/counts.npz": check_measures,
    "metrics/matching.npz": check_matching,
}
