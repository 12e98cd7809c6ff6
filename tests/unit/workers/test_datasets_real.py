"""Round trips of real excerpts, some frames each; `tests.dataset_folders.round_trips`: all."""

from pathlib import Path

import pytest

from tests.dataset_folders.round_trips import round_trip

pytestmark = pytest.mark.reference

LARGEST_POSE_ERROR_M = 0.001
SINGLE_PRECISION_M = 1e-9
"""PandaSet's points go to the world and back: a coordinate of zero becomes a rounding error."""


@pytest.mark.parametrize(
    ("name", "frames"),
    [("kitti-raw", 2), ("kitti360", 2), ("semantickitti", 4), ("argoverse2", 2), ("pandaset", 2)],
)
def test_an_excerpt_comes_back_as_it_was(
    reference: Path, tmp_path: Path, name: str, frames: int
) -> None:
    found = round_trip(name, reference, tmp_path, frames=frames)
    assert found["frames"] == found["expected_frames"] == frames
    assert found["points"] > 190_000
    assert found["largest_point_error_m"] < SINGLE_PRECISION_M
    assert found["largest_pose_error_m"] < LARGEST_POSE_ERROR_M
    compared, differing = found["codes_compared"], found["codes_differing"]
    if name == "semantickitti":
        assert differing == {"motion": 0, "semantic19": 0, "ground": 0}
    if name == "argoverse2":
        # the pack has Argoverse 2's own flag of dynamic points as well, boxes do not
        assert differing["motion"] <= 70
        assert differing["semantic"] <= 5
    if name == "pandaset":
        # the boxes of the pack are rounded to millimetres
        assert differing["semantic"] == differing["ground"] == 0
        assert differing["track"] <= 1e-4 * compared["track"]
