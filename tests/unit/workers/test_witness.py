import numpy as np
import pytest

from workers.free_space import FREE, HIDDEN, OCCUPIED
from workers.lidar.registration_check import extract_structure, register_structures
from workers.points.se3 import transform
from workers.witness.free_space_votes import votes_of
from workers.witness.pose_repair import PoseCheck

S = np.int8


def _answers(*by_frame: tuple[int, ...]) -> list[np.ndarray[tuple[int], np.dtype[np.int8]]]:
    return [np.array(answer, S) for answer in by_frame]


def test_what_leaves_its_place_late_is_seen_through_by_the_farthest_frames() -> None:
    # farthest first; the third place is hidden from the farthest
    said = votes_of(
        _answers(
            (FREE, FREE, HIDDEN),
            (FREE, OCCUPIED, FREE),
            (OCCUPIED, FREE, FREE),
            (OCCUPIED, OCCUPIED, OCCUPIED),
            (OCCUPIED, OCCUPIED, OCCUPIED),
        ),
        3,
    )
    assert said.seen_through.tolist() == [True, False, True]
    assert said.run.tolist() == [2, 1, 2]


def test_one_frame_is_no_opinion() -> None:
    assert not votes_of(_answers((FREE,)), 1).seen_through[0]


def _street() -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Two facades, and the ends of parked cars across the road."""
    rng = np.random.default_rng(3)
    along, up = rng.uniform(-30, 30, (2, 3000)), rng.uniform(-1, 4, (2, 3000))
    walls = [np.column_stack([along[i], np.full(3000, y), up[i]]) for i, y in enumerate((-9, 10))]
    ends = [
        np.column_stack([np.full(150, x), rng.uniform(3, 5, 150), rng.uniform(-1.5, 0, 150)])
        for x in range(-24, 25, 6)
    ]
    street: np.ndarray[tuple[int, int], np.dtype[np.float32]] = np.concatenate(
        [*walls, *ends]
    ).astype(np.float32)
    return street


def _moved(turn_deg: float, ahead_m: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    pose = np.eye(4)
    pose[:2, :2], pose[0, 3] = [[cos, -sin], [sin, cos]], ahead_m
    return pose


@pytest.mark.parametrize(("turn_deg", "ahead_m"), [(0.5, 0.0), (0.0, 0.2), (1.0, -0.25)])
def test_a_second_registration_says_how_far_a_pose_is_off(turn_deg: float, ahead_m: float) -> None:
    street = _street()
    reference = extract_structure(street, np.zeros(3))
    slipped = extract_structure(transform(_moved(turn_deg, ahead_m), street), np.zeros(3))
    assert reference is not None
    assert slipped is not None
    misfit = register_structures(reference, slipped)
    assert misfit is not None
    assert np.degrees(misfit.turn_rad) == pytest.approx(abs(turn_deg), abs=0.1)
    assert misfit.after_m < misfit.before_m
    back = misfit.correction @ _moved(turn_deg, ahead_m)
    assert np.allclose(back, np.eye(4), atol=0.03)


def test_a_slip_is_told_and_put_back_and_a_healthy_pose_is_left_alone() -> None:
    street, check = _street(), PoseCheck()
    for frame in range(3):
        assert check.judge(street, np.eye(4), frame * 100_000_000).problem == ""
    slip = _moved(0.8, 0.15)
    fit = check.judge(transform(slip, street), slip, 300_000_000)
    assert "0.8 degrees off over 0.1 s" in fit.problem
    assert fit.correction is not None
    again = check.judge(
        transform(fit.correction @ slip, street), fit.correction @ slip, 400_000_000
    )
    assert again.problem == ""
    assert again.correction is None
