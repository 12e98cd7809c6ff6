"""A frame whose pose is wrong does not fit those before it, however it was come by."""

import numpy as np
import pytest
from numpy.typing import NDArray

from workers.selfsupervised.pose_consistency import FLOOR_M, PoseConsistency, misfit_m
from workers.selfsupervised.registration import Reference, build_reference

CENTRE_M = np.zeros(3)


def street(*, seed: int = 0, noise_m: float = 0.02) -> NDArray[np.float32]:
    """Voxels of walls along x, houses' fronts across, and posts; each frame hits others of them."""
    some = np.random.default_rng(seed)
    along = some.uniform([-30, 9.99, -1], [30, 10.01, 3], (6000, 3))
    across = some.uniform([19.99, -10, -1], [20.01, 10, 3], (3000, 3))
    posts = some.uniform([-0.1, -0.1, -1], [0.1, 0.1, 2], (1000, 3))
    posts[:, :2] += np.stack([np.arange(1000) % 9 * 4.0 - 16.0, np.full(1000, -6.0)], axis=-1)
    points: NDArray[np.float64] = np.concatenate([along, across, posts])
    return np.asarray(points + some.normal(0.0, noise_m, points.shape), dtype=np.float32)


def reference(points: NDArray[np.float32], *, age_s: float = 0.1) -> Reference:
    return build_reference(points, CENTRE_M, age_s)


def problems(
    *frames: NDArray[np.float32], expected_m: NDArray[np.float64] | None = CENTRE_M
) -> list[str]:
    """Let a monitor see frames, each compared with the first one of the street."""
    monitor, first = PoseConsistency(), street(seed=99)
    near, far = reference(first), reference(first, age_s=0.5)
    return [
        monitor.problem(
            points,
            CENTRE_M,
            near=(near, np.ones(len(points), np.bool_)),
            far=(far, np.ones(len(points), np.bool_)),
            expected_m=expected_m,
        )
        for points in frames
    ]


def moved(points: NDArray[np.float32], x_m: float, y_m: float) -> NDArray[np.float32]:
    return points + np.array([x_m, y_m, 0.0], np.float32)


def turned(points: NDArray[np.float32], yaw_rad: float) -> NDArray[np.float32]:
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    out = points.copy()
    out[:, :2] = points[:, :2] @ np.array([[cos, sin], [-sin, cos]], np.float32)
    return out


def test_frames_of_a_street_that_stands_fit() -> None:
    assert problems(*(street(seed=i) for i in range(5))) == [""] * 5


@pytest.mark.parametrize(
    "shift_m", [pytest.param((0.6, 0.0), id="along"), pytest.param((0.0, 0.4), id="across")]
)
def test_a_step_of_the_pose_is_seen_even_along_the_walls(shift_m: tuple[float, ...]) -> None:
    good = [street(seed=i) for i in range(3)]
    *fits, bad, again = problems(*good, moved(street(seed=4), *shift_m), street(seed=5))
    assert fits == ["", "", ""]
    assert "0.1 s ago" in bad
    assert "is usual" in bad
    assert again == "", "what did not fit is not remembered as usual"


def test_a_turn_of_the_pose_is_seen_and_noise_of_a_tenth_of_a_degree_is_not() -> None:
    good = [street(seed=i) for i in range(3)]
    *_, noise, turn = problems(
        *good, turned(street(seed=4), np.radians(0.1)), turned(street(seed=5), np.radians(2.0))
    )
    assert noise == ""
    assert turn != ""


def test_a_sensor_that_is_always_coarse_is_not_refused() -> None:
    some = np.random.default_rng(1)
    coarse = [street(seed=i)[some.permutation(10_000)[:300]] for i in range(4)]
    monitor, past = PoseConsistency(), reference(coarse[0])
    assert misfit_m(coarse[1], past) > FLOOR_M
    known = np.ones(300, np.bool_)
    for points in coarse[1:]:
        assert (
            monitor.problem(
                points, CENTRE_M, near=(past, known), far=(past, known), expected_m=CENTRE_M
            )
            == ""
        )


def test_a_sixth_of_the_street_may_move_all_at_once() -> None:
    good = [street(seed=i) for i in range(3)]
    crowd = street(seed=4)
    crowd[1::6, 0] += 2.0
    assert problems(*good, crowd)[-1] == ""


def another_street(seed: int) -> NDArray[np.float32]:
    """A third of what is near was not there before: a front behind the next corner."""
    points = street(seed=seed)
    some = np.random.default_rng(seed)
    new = some.random(len(points)) < 1 / 3
    points[new] = some.uniform([-25, -14.01, -1], [15, -13.99, 3], (int(new.sum()), 3))
    return points


def test_what_is_new_in_a_street_is_no_fault_of_the_pose() -> None:
    good = [street(seed=i) for i in range(3)]
    new = another_street(4)
    assert misfit_m(new, reference(street(seed=99))) > 2 * FLOOR_M
    assert problems(*good, new)[-1] == ""


@pytest.mark.parametrize(
    "bad",
    [
        pytest.param(moved(another_street(4), 0.0, 0.3), id="aside"),
        pytest.param(turned(another_street(4), np.radians(0.5)), id="turned"),
    ],
)
def test_a_wrong_pose_in_a_new_street_is_seen(bad: NDArray[np.float32]) -> None:
    assert "is usual" in problems(*(street(seed=i) for i in range(3)), bad)[-1]


@pytest.mark.parametrize("expected_m", [None, np.array([0.4, 0.0, 0.0])])
def test_a_car_that_does_not_go_on_as_it_went_gets_no_second_look(
    expected_m: NDArray[np.float64] | None,
) -> None:
    good = [street(seed=i) for i in range(3)]
    assert problems(*good, another_street(4), expected_m=expected_m)[-1] != ""


def test_nothing_near_is_no_problem() -> None:
    far_off = moved(street(seed=4), 500.0, 0.0)
    assert problems(street(seed=1), far_off, far_off[:0]) == ["", "", ""]
