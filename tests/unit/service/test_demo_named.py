"""The first reason of a demo's scene names a planted failure if the truth of its points says so."""

from pathlib import Path
from typing import Any

import pytest

from service.demo.scored_explanations import PlantedPoints
from tests.demo_truth import one_thing, write_truth
from tests.factories import BEGIN_NS
from workers.lab.simulation.faults.fault_truth import FailureRow
from workers.lab.simulation.faults.plan import FailureKind


def failure(kind: FailureKind, **changes: Any) -> FailureRow:
    fields = {
        "kind": kind,
        "track": -1,
        "class_name": "car",
        "scene": 0,
        "start_s": 0.0,
        "end_s": 1.0,
        "start_ns": BEGIN_NS,
        "end_ns": BEGIN_NS + 1_000_000_000,
        "common_mode": False,
        "because": "",
        "other_track": -1,
        "place_m": None,
        "range_m": 0.0,
    }
    return FailureRow(**(fields | changes))


SWAP = failure(FailureKind.LABEL_SWAP, track=7, other_track=4)
MISSED = failure(FailureKind.MISSED_MOVER, track=5)
GHOST = failure(FailureKind.GHOST_MOVER, place_m=(100.0, 9.0, 0.0))
LIMIT = failure(FailureKind.RANGE_LIMIT, range_m=30.0)


@pytest.mark.parametrize(
    ("planted", "on", "named"),
    [
        pytest.param(MISSED, [5], True, id="the object itself"),
        pytest.param(MISSED, [4], False, id="another object"),
        pytest.param(MISSED, [5, -1], False, id="half of it is nobody's"),
        pytest.param(SWAP, [4], True, id="the partner of a swap"),
        pytest.param(SWAP, [-1], False, id="no partner is not nobody"),
        pytest.param(GHOST, [-1], True, id="the place of a ghost"),
        pytest.param(GHOST, [4], False, id="beside a ghost"),
        pytest.param(LIMIT, [5], True, id="a mover beyond the limit"),
        pytest.param(LIMIT, [4], False, id="what stands within it"),
    ],
)
def test_points_tell_whether_it_is_what_was_planted(
    planted: FailureRow, on: list[int], named: bool, tmp_path: Path
) -> None:
    write_truth(tmp_path, stamps_ns=[BEGIN_NS])
    overlay = one_thing("a/lidar/1", stamp_ns=BEGIN_NS, on=on)
    assert PlantedPoints(tmp_path).first_reason_names(overlay, [planted]) is named


def test_a_thing_is_not_named_while_nothing_is_wrong_about_it(tmp_path: Path) -> None:
    write_truth(tmp_path, stamps_ns=[BEGIN_NS])
    later = MISSED.model_copy(update={"start_ns": BEGIN_NS + 1})
    points = PlantedPoints(tmp_path)
    overlay = one_thing("a/lidar/1", stamp_ns=BEGIN_NS, on=[5])
    assert not points.first_reason_names(overlay, [later])
    assert not points.first_reason_names(overlay, [MISSED], track_id=1)
