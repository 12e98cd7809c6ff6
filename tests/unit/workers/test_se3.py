import numpy as np
from numpy.testing import assert_allclose

from workers.points.se3 import inverse, transform


def _turned_left_at(x_m: float, y_m: float) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    pose = np.eye(4)
    pose[:2, :2] = [[0, -1], [1, 0]]
    pose[:2, 3] = x_m, y_m
    return pose


def test_a_point_ahead_of_a_sensor_that_looks_left_lies_to_the_left() -> None:
    odom_from_sensor = _turned_left_at(10, 0)
    ahead = np.array([[5, 0, 1]], dtype=np.float32)
    moved = transform(odom_from_sensor, ahead)
    assert_allclose(moved, [[10, 5, 1]], atol=1e-6)
    assert moved.dtype == np.float32


def test_there_and_back_is_no_journey() -> None:
    odom_from_sensor = _turned_left_at(1234.5, -99.25)
    points = np.random.default_rng(1).normal(scale=50, size=(100, 3)).astype(np.float32)
    back = transform(inverse(odom_from_sensor) @ odom_from_sensor, points)
    assert_allclose(back, points, atol=1e-5)


def test_a_far_origin_costs_no_millimetres() -> None:
    far = np.eye(4)
    far[:3, 3] = 5e6
    near = transform(inverse(far) @ far, np.array([[0.001, 0.002, 0.003]], dtype=np.float32))
    assert_allclose(near, [[0.001, 0.002, 0.003]], atol=1e-7)
