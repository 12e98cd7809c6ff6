"""A detector's output on a real street, mined end to end: what was planted is found."""

from pathlib import Path

import numpy as np
import pytest

from tests import detector_bench
from tests.detector_bench import KINDS, judge, mine, write_copy
from tests.detector_output import detector_boxes, plant, read_truth

LOG = "pandaset/panda-01/2019-05-11/pandaset-002"
REPORTED = range(28, 56)
STRONG = 0.3


@pytest.mark.reference
def test_movers_that_a_detector_misses_or_states_to_stand_are_found(
    reference: Path, tmp_path: Path
) -> None:
    folder = reference / "data" / "truth" / LOG
    truth = read_truth(folder)
    rng = np.random.default_rng(1)
    planted = plant(truth, rng, REPORTED)
    boxes = detector_boxes(truth, planted, rng)
    copy = tmp_path / "drive.mcap"
    base_from_lidar = detector_bench.read_base(folder)
    log = reference / "data" / "logs" / f"{LOG}.mcap"
    write_copy(log, copy, KINDS["tracked"], truth, boxes, base_from_lidar)
    scores, said = mine(copy)
    assert [each for each in said if "no mapping knows" not in each] == []
    assert all(score.supervised is None for score in scores)
    judged = judge(truth, planted, boxes, scores, REPORTED)
    assert [each.kind for each in planted].count("missed") == 3
    for each, strength in zip(judged.planted, judged.found, strict=True):
        if each.kind in ("missed", "stands"):
            assert strength > STRONG, each
    strong = [(about, said) for strength, _, about, said in judged.tracks if strength > STRONG]
    assert [about for about, _ in strong].count("other") == 0
    missed = [said for about, said in strong if about.startswith("missed")]
    assert [said for said in missed if "supervised has no box there, but" not in said] == []
    stands = [said for about, said in strong if about.startswith("stands")]
    assert [said for said in stands if " static, but" not in said] == []
