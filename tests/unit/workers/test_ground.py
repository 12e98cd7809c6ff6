import numpy as np
import pytest
from numpy.typing import NDArray

from workers.lidar.ground import ground_mask
from workers.lidar.sensor_height import estimate_sensor_height

HEIGHT_M = 1.8


def rings(radii: NDArray[np.float64], z: float) -> NDArray[np.float64]:
    azimuth = np.radians(np.arange(0.0, 360.0, 0.4))
    radius, angle = np.meshgrid(radii, azimuth, indexing="ij")
    some = np.random.default_rng(0)
    return np.stack(
        [
            radius * np.cos(angle),
            radius * np.sin(angle),
            z + some.normal(0.0, 0.02, radius.shape),
        ],
        axis=-1,
    ).reshape(-1, 3)


def side_of_a_car(x: float, y: float) -> NDArray[np.float64]:
    along, up = np.meshgrid(np.arange(0.0, 4.4, 0.05), np.arange(0.15, 1.4, 0.1))
    return np.stack([x + along, np.full_like(along, y), up - HEIGHT_M], axis=-1).reshape(-1, 3)


def street() -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A road, and a car four metres beside us that hides the road behind it."""
    road = rings(np.geomspace(3.0, 60.0, 40), -HEIGHT_M)
    shadow = (np.abs(road[:, 0]) < 6.0) & (road[:, 1] > 4.0) & (road[:, 1] < 20.0)
    road = road[~shadow]
    car = side_of_a_car(-2.0, 4.0)
    points = np.concatenate([road, car]).astype(np.float32)
    return points, np.arange(len(points)) < len(road)


def test_the_road_is_ground_and_the_car_beside_us_is_not() -> None:
    points, is_road = street()
    mask = ground_mask(points, sensor_height_m=HEIGHT_M)
    assert mask[is_road].mean() > 0.95
    # the lowest hand's breadth of a car cannot be told from the road
    above = ~is_road & (points[:, 2] > -HEIGHT_M + 0.3)
    assert mask[above].mean() < 0.02


def test_nothing_high_above_the_road_is_ground_however_flat_it_is() -> None:
    roof = rings(np.linspace(5.0, 15.0, 20), 0.5).astype(np.float32)
    assert not ground_mask(roof, sensor_height_m=HEIGHT_M).any()


def test_ground_hangs_on_nothing_but_the_cloud() -> None:
    points, _ = street()
    first = ground_mask(points, sensor_height_m=HEIGHT_M)
    ground_mask(points[::2].copy(), sensor_height_m=HEIGHT_M)
    np.testing.assert_array_equal(ground_mask(points, sensor_height_m=HEIGHT_M), first)


@pytest.mark.parametrize("count", [0, 1, 2, 50])
def test_too_few_points_for_a_plane_are_no_ground(count: int) -> None:
    points = np.full((count, 3), -1.0, np.float32)
    assert not ground_mask(points, sensor_height_m=HEIGHT_M).any()


def test_results_on_stdout_are_not_mixed_with_the_greeting_of_the_library(
    capfd: pytest.CaptureFixture[str],
) -> None:
    points, _ = street()
    ground_mask(points, sensor_height_m=HEIGHT_M)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("height_m", [0.9, 1.73, 2.4])
def test_the_height_of_the_sensor_is_that_of_the_road_below_it(height_m: float) -> None:
    road = rings(np.geomspace(3.0, 60.0, 40), -height_m)
    wall = np.stack(
        np.meshgrid(np.arange(-20.0, 20.0, 0.2), [8.0], np.arange(-height_m, 3.0, 0.1)), axis=-1
    ).reshape(-1, 3)
    points = np.concatenate([road, wall]).astype(np.float32)
    assert estimate_sensor_height(points) == pytest.approx(height_m, abs=0.05)


def test_cars_in_a_jam_do_not_make_the_road_higher_than_it_is() -> None:
    road = rings(np.array([4.0, 9.0]), -2.3)
    doors = np.concatenate(
        [side_of_a_car(x, y) for x in np.arange(-19.0, 16.0, 5.0) for y in (-7.0, -4.0, 4.0, 7.0)]
    )
    # few beams reach lower than the doors: the first 0.4 m over the road are seen in no column
    doors = doors[doors[:, 2] > 0.5 - HEIGHT_M] - (0.0, 0.0, 2.3 - HEIGHT_M)
    points = np.concatenate([road, doors]).astype(np.float32)
    assert estimate_sensor_height(points) == pytest.approx(2.3, abs=0.05)


def test_a_few_reflections_under_the_road_are_not_the_road() -> None:
    road = rings(np.geomspace(3.0, 60.0, 40), -HEIGHT_M)
    under = rings(np.array([6.0]), -HEIGHT_M - 1.0)[::20]
    points = np.concatenate([road, under]).astype(np.float32)
    assert estimate_sensor_height(points) == pytest.approx(HEIGHT_M, abs=0.05)


def test_a_roof_is_assumed_where_no_road_is_seen() -> None:
    assert estimate_sensor_height(np.zeros((0, 3), np.float32)) == pytest.approx(1.8)
