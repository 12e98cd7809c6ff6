from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.frame import PosedFrame
from tests.factories import frame, pose, posed
from workers.contradiction.rising_ground import RisingGround, rising_share

HEIGHT_M = 1.8
FRAMES = 12
Cloud = NDArray[np.float64]


def _box(x_m: float, y_m: float, size_m: tuple[float, float, float]) -> Cloud:
    """The upper side and the four walls of a thing that stands on the road."""
    half_x, half_y, top = size_m[0] / 2, size_m[1] / 2, size_m[2]
    axes = (
        np.arange(-half_x, half_x + 0.01, 0.2),
        np.arange(-half_y, half_y + 0.01, 0.2),
        np.arange(0.1, top + 0.01, 0.2),
    )
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    rim = (np.abs(grid[:, 0]) > half_x - 0.2) | (np.abs(grid[:, 1]) > half_y - 0.2)
    roof = grid[:, 2] > top - 0.2
    box: Cloud = grid[rim | roof] + [x_m, y_m, -HEIGHT_M]
    return box


def _road() -> Cloud:
    side = np.arange(-22.0, 22.0, 0.2)
    x, y = np.meshgrid(side, side, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, -HEIGHT_M)], axis=1)


def _shares(
    things: Callable[[int], Cloud], road: Callable[[int], Cloud], *, step_m: float
) -> float:
    """Share of the ground that rises around the first thing, which is called for in each frame."""
    frames: list[PosedFrame] = []
    counts = []
    for number in range(FRAMES):
        here = np.array([step_m * number, 0.0, 0.0])
        thing = things(number)
        ground = road(number)
        # what a thing stands on is hidden
        low, high = thing[:, :2].min(axis=0), thing[:, :2].max(axis=0)
        hidden = ((ground[:, :2] > low) & (ground[:, :2] < high)).all(axis=1)
        cloud = np.concatenate([thing, ground[~hidden]]) - here
        counts.append(len(thing))
        frames.append(posed(frame(cloud, at_s=number / 10.0), pose(here[0])))
    rising = RisingGround(frames)
    return rising_share([rising.around(n, np.arange(count)) for n, count in enumerate(counts)])


def _flat(_: int) -> Cloud:
    return _road()


def _leaking(number: int) -> Cloud:
    """Patches of two metres lie half a metre higher, other ones in every frame."""
    road = _road()
    patch = np.floor(road[:, :2] / 2.0).astype(np.int64) @ [31, 17]
    road[np.random.default_rng(number).random(1024)[patch % 1024] < 0.4, 2] += 0.5
    return road


def _parked(_: int) -> Cloud:
    return _box(10.0, 4.0, (4.4, 1.8, 1.5))


@pytest.mark.parametrize("step_m", [0.0, 0.8], ids=["the car stands", "the car drives"])
def test_ground_that_rises_around_a_thing_is_found(step_m: float) -> None:
    assert _shares(_parked, _flat, step_m=step_m) == 0.0
    assert 0.1 < _shares(_parked, _leaking, step_m=step_m) < 0.5


@pytest.mark.parametrize(
    ("size_m", "speed_m_per_s"),
    [((4.4, 1.8, 1.5), 10.0), ((0.9, 0.4, 0.6), 3.0), ((0.6, 0.6, 1.7), 1.5)],
    ids=["a car", "a dog", "a person"],
)
def test_what_moves_over_the_road_is_not_the_road(
    size_m: tuple[float, float, float], speed_m_per_s: float
) -> None:
    def moving(number: int) -> Cloud:
        return _box(-6.0 + speed_m_per_s * number / 10.0, 5.0, size_m)

    assert _shares(moving, _flat, step_m=0.0) == 0.0


def test_what_always_lies_there_is_no_road() -> None:
    def kerbs(_: int) -> Cloud:
        road = _road()
        road[np.abs(road[:, 1] - 6.0) < 1.0, 2] += 0.5
        return road

    assert _shares(_parked, kerbs, step_m=0.5) == 0.0


def test_a_slope_and_a_step_of_the_road_are_not_taken_for_it() -> None:
    def hilly(_: int) -> Cloud:
        road = _road()
        road[:, 2] += 0.1 * road[:, 0] + 0.12 * (road[:, 1] > 2.0)
        return road

    assert _shares(_parked, hilly, step_m=0.0) == 0.0


def test_two_frames_say_nothing_of_the_ground() -> None:
    frames = [posed(frame(_leaking(number), at_s=number / 10.0)) for number in range(2)]
    rising = RisingGround(frames)
    assert rising.around(0, np.arange(40)) == (0, 0)
    assert rising_share([(0, 0), (0, 0)]) == 0.0


def test_points_without_a_place_and_a_car_on_its_side_are_borne() -> None:
    cloud = _leaking(0)
    cloud[::7] = np.nan
    cloud[::11] = 1e6
    valid = np.isfinite(cloud).all(axis=1)
    side = np.eye(4)[[0, 2, 1, 3]]
    frames = [posed(frame(cloud, at_s=n / 10.0, valid_mask=valid), side) for n in range(4)]
    rising = RisingGround(frames)
    assert rising.around(1, np.flatnonzero(valid)[:50])[1] >= 0


def test_a_pose_that_went_astray_costs_its_own_frame() -> None:
    """Cells from here to there would fill any memory."""

    def told(away_m: float) -> list[tuple[int, int]]:
        frames = [
            posed(frame(_leaking(n), at_s=n / 10.0), pose(away_m if n == FRAMES - 1 else 0.0))
            for n in range(FRAMES)
        ]
        rising = RisingGround(frames)
        return [rising.around(n, np.arange(50)) for n in range(FRAMES)]

    far, farther = told(-1e4), told(1e9)
    assert far == farther
    assert far[-1] == (0, 0)
    assert sum(asked for _, asked in far) > 0


def test_one_frame_that_is_lifted_whole_rises_whole() -> None:
    """A kerb hit hard, a pose that is wrong in height: all of the ground at once."""

    def shaken(number: int) -> Cloud:
        road = _road()
        road[:, 2] += 0.4 * (number == 5)
        return road

    frames = [posed(frame(shaken(number), at_s=number / 10.0)) for number in range(FRAMES)]
    rising = RisingGround(frames)
    thing = np.flatnonzero((np.abs(_road()[:, :2] - 8.0) < 0.5).all(axis=1))
    told = [rising.around(number, thing) for number in range(FRAMES)]
    assert rising_share([told[5]]) == 1.0
    assert rising_share(told[:5] + told[6:]) == 0.0


def test_the_origin_of_odom_space_does_not_matter() -> None:
    thing = np.arange(50)

    def told(away_m: float) -> list[tuple[int, int]]:
        frames = [
            posed(replace(frame(_leaking(n)), stamp_ns=n * 10**8), pose(away_m, -away_m))
            for n in range(FRAMES)
        ]
        rising = RisingGround(frames)
        return [rising.around(n, thing) for n in range(FRAMES)]

    assert told(0.0) == told(4096.0)
