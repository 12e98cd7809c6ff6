import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.arrays import Points
from workers.lidar.fidelity import Form
from workers.lidar.range_image import RangeImage, SensorProfile, project
from workers.supervised.postprocess import KnnSettings, find_voters

PROFILE = SensorProfile(name="test", rows=8, columns=64, fov_up_deg=8, fov_down_deg=-8)
CAR, HOUSE = 1, 2


def _pixel(row: int, column: int, range_m: float) -> tuple[float, float, float]:
    up = np.radians(8 - (row + 0.5) * 2)
    left = np.pi - (column + 0.5) / 64 * 2 * np.pi
    flat = np.cos(up) * range_m
    return flat * np.cos(left), flat * np.sin(left), np.sin(up) * range_m


def _house_behind_a_car() -> tuple[Points, NDArray[np.uint8]]:
    """A house at 30 m in every pixel, a car at 10 m before columns 30 to 33, both in the frame."""
    house = [_pixel(row, column, 30) for row in range(8) for column in range(64)]
    car = [_pixel(row, column, 10) for row in range(8) for column in range(30, 34)]
    truth = np.array([HOUSE] * len(house) + [CAR] * len(car), dtype=np.uint8)
    return np.array(house + car, dtype=np.float32), truth


def _seen(image: RangeImage, truth: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.where(image.index >= 0, truth[image.index], 0).astype(np.uint8)


def test_a_house_seen_past_the_edge_of_a_car_does_not_become_a_car() -> None:
    points, truth = _house_behind_a_car()
    image = project(points, PROFILE)
    found = find_voters(image, [_seen(image, truth)], KnnSettings()).vote(_seen(image, truth))
    hidden_at_the_edge = (image.column == 30) & (truth == HOUSE)
    assert hidden_at_the_edge.sum() == 8
    assert (found[hidden_at_the_edge] == HOUSE).all()
    assert (found[truth == CAR] == CAR).all()


def test_points_without_a_pixel_get_no_class() -> None:
    points, truth = _house_behind_a_car()
    valid = np.arange(len(points)) % 3 > 0
    image = project(points, PROFILE, valid_mask=valid)
    found = find_voters(image, [_seen(image, truth)], KnnSettings()).vote(_seen(image, truth))
    assert (found[~valid] == 0).all()
    assert (found[valid] > 0).all()


def test_leaving_out_uniform_surroundings_changes_no_answer() -> None:
    rng = np.random.default_rng(3)
    points, truth = _house_behind_a_car()
    points *= rng.uniform(0.98, 1.02, size=(len(points), 1)).astype(np.float32)
    image = project(points, PROFILE, valid_mask=rng.random(len(points)) > 0.1)
    classes = _seen(image, truth)
    noise = rng.integers(1, 4, size=classes.shape).astype(np.uint8)  # contests every pixel
    lean = find_voters(image, [classes], KnnSettings())
    full = find_voters(image, [classes, noise], KnnSettings())
    assert len(lean.contested) < len(full.contested)
    np.testing.assert_array_equal(lean.vote(classes), full.vote(classes))


@pytest.mark.parametrize(("form", "expected"), [(Form.CORRECTED, CAR), (Form.PAPER, HOUSE)])
def test_the_first_column_continues_the_last(form: Form, expected: int) -> None:
    """A point behind the sensor, its pixel hidden by a house, its fellows beyond the seam."""
    beyond_the_seam = [_pixel(row, column, 20) for row in range(2, 7) for column in (62, 63)]
    points = np.array([_pixel(4, 0, 20), _pixel(4, 0, 5), *beyond_the_seam], dtype=np.float32)
    truth = np.array([CAR, HOUSE] + [CAR] * len(beyond_the_seam), dtype=np.uint8)
    image = project(points, PROFILE)
    classes = _seen(image, truth)
    voters = find_voters(image, [classes, np.full_like(classes, 3)], KnnSettings(form=form))
    assert voters.vote(classes)[0] == expected


def test_an_average_is_taken_over_those_who_vote() -> None:
    points, truth = _house_behind_a_car()
    image = project(points, PROFILE)
    classes = _seen(image, truth)
    share = np.where(classes == CAR, np.float32(0.9), np.float32(0.1))
    voters = find_voters(image, [classes], KnnSettings())
    found = voters.average(share)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[truth == CAR], 0.9, atol=0.2)
    far_from_the_car = np.flatnonzero((image.column < 20) & (truth == HOUSE))
    np.testing.assert_allclose(found[far_from_the_car], 0.1)


def test_an_empty_frame_has_no_voters() -> None:
    image = project(np.zeros((0, 3), dtype=np.float32), PROFILE)
    voters = find_voters(image, [np.zeros((8, 64), dtype=np.uint8)], KnnSettings())
    assert len(voters.vote(np.zeros((8, 64), dtype=np.uint8))) == 0


@pytest.mark.parametrize(("form", "expected"), [(Form.CORRECTED, 0), (Form.PAPER, 1)])
def test_who_has_no_voter_has_no_class_and_as_published_the_first(
    form: Form, expected: int
) -> None:
    image = project(np.array([_pixel(4, 20, 20)], dtype=np.float32), PROFILE)
    nothing = np.zeros(image.index.shape, dtype=np.uint8)
    assert find_voters(image, [nothing], KnnSettings(form=form)).vote(nothing) == expected


@pytest.mark.parametrize(("form", "expected"), [(Form.CORRECTED, CAR), (Form.PAPER, HOUSE)])
def test_as_published_nothing_beyond_the_image_takes_votes_of_near_returns(
    form: Form, expected: int
) -> None:
    """A return at 0.9 m in the top row: its two votes stand against more cars farther away."""
    cars = [_pixel(row, column, 1.95) for row in range(3) for column in range(28, 33)]
    own = [_pixel(0, 30, 0.9), _pixel(0, 30, 0.85)]
    house = [_pixel(0, 29, 0.9), _pixel(0, 31, 0.9)]
    points = np.array([*own, *house, *cars], dtype=np.float32)
    truth = np.array([HOUSE] * 4 + [CAR] * len(cars), dtype=np.uint8)
    image = project(points, PROFILE)
    classes = _seen(image, truth)
    settings = KnnSettings(neighbours=15, form=form)
    assert find_voters(image, [classes], settings).vote(classes)[0] == expected
