import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S, Points, Transform
from workers.lidar.range_image import SensorProfile, project
from workers.supervised.residual_image import ResidualHistory, ResidualSettings

PROFILE = SensorProfile(name="test", rows=16, columns=128, fov_up_deg=10, fov_down_deg=-10)
SETTINGS = ResidualSettings(ages_s=(0.1, 0.2), max_range_m=50)
TENTH_NS = NS_PER_S // 10


def _wall(distance_m: float) -> Points:
    """A wall across the view, seen from the origin, one point in the middle of each pixel ahead."""
    azimuth = np.pi - (np.arange(48, 80) + 0.5) / 128 * 2 * np.pi
    elevation = np.radians(10 - (np.arange(16) + 0.5) / 16 * 20)
    left, up = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
    x = np.full(left.shape, distance_m)
    return np.stack([x, x * np.tan(left), x / np.cos(left) * np.tan(up)], axis=1).astype(np.float32)


def _at(x_m: float) -> Transform:
    pose = np.eye(4)
    pose[0, 3] = x_m
    return pose


def _stream(
    *frames: tuple[int, float, float], settings: ResidualSettings = SETTINGS
) -> tuple[NDArray[np.float32], int]:
    """Feed (stamp in tenths of a second, sensor x, wall's distance); residuals of the last."""
    history = ResidualHistory(PROFILE, settings)
    answer = np.zeros(0, dtype=np.float32), -1
    for tenths, x_m, distance_m in frames:
        points, pose, stamp_ns = _wall(distance_m), _at(x_m), tenths * TENTH_NS
        answer = history.residuals(
            project(points, PROFILE), stamp_ns=stamp_ns, odom_from_sensor=pose
        )
        history.push(points, stamp_ns=stamp_ns, odom_from_sensor=pose)
    return answer


def test_a_wall_we_drive_towards_has_no_residual() -> None:
    residuals, found = _stream((0, 0.0, 20.0), (1, 1.0, 19.0), (2, 2.0, 18.0))
    assert found == 2
    assert np.median(residuals[:, 4:12, 56:72]) < 0.003


def test_a_wall_that_comes_towards_us_has_one_as_large_as_its_way() -> None:
    residuals, _ = _stream((0, 0.0, 20.0), (1, 0.0, 19.0), (2, 0.0, 18.0))
    younger, older = (np.median(image[4:12, 56:72]) for image in residuals)
    assert younger == pytest.approx(1 / 18, abs=0.003)
    assert older == pytest.approx(2 / 18, abs=0.003)


def test_pixels_without_a_return_in_both_frames_have_no_residual() -> None:
    residuals, _ = _stream((0, 0.0, 20.0), (1, 0.0, 18.0))
    assert (residuals[0, :, :40] == 0).all()


@pytest.mark.parametrize(("near_m", "far_m"), [(60.0, 70.0), (0.5, 1.0)])
def test_what_lies_outside_the_gate_is_not_compared(near_m: float, far_m: float) -> None:
    residuals, found = _stream((0, 0.0, far_m), (1, 0.0, near_m))
    assert found == 1
    assert (residuals == 0).all()


def test_the_first_frame_has_nothing_to_be_compared_with() -> None:
    residuals, found = _stream((0, 0.0, 20.0))
    assert found == 0
    assert residuals.shape == (2, 16, 128)
    assert (residuals == 0).all()


def test_a_dropped_frame_empties_its_own_channel_only() -> None:
    residuals, found = _stream((0, 0.0, 20.0), (2, 0.0, 18.0))
    assert found == 1
    assert (residuals[0] == 0).all()
    assert np.median(residuals[1, 4:12, 56:72]) == pytest.approx(2 / 18, abs=0.003)


def test_a_sensor_twice_as_fast_gives_the_same_residuals() -> None:
    halves = [(2 * tenth, 20.0 - tenth / 2) for tenth in range(5)]
    fast = ResidualHistory(PROFILE, SETTINGS)
    residuals = np.zeros((2, 16, 128), dtype=np.float32)
    for count, (_, distance_m) in enumerate(halves):
        stamp_ns = count * TENTH_NS // 2
        points = _wall(distance_m)
        residuals, _ = fast.residuals(
            project(points, PROFILE), stamp_ns=stamp_ns, odom_from_sensor=np.eye(4)
        )
        fast.push(points, stamp_ns=stamp_ns, odom_from_sensor=np.eye(4))
    slow, _ = _stream((0, 0.0, 20.0), (1, 0.0, 19.0), (2, 0.0, 18.0))
    np.testing.assert_array_equal(residuals, slow)


def test_a_jump_back_in_time_forgets_the_past() -> None:
    _, found = _stream((10, 0.0, 20.0), (11, 0.0, 20.0), (5, 0.0, 20.0), (6, 0.0, 20.0))
    assert found == 1


def test_the_past_does_not_grow_for_ever() -> None:
    history = ResidualHistory(PROFILE, SETTINGS)
    for tenth in range(50):
        history.push(_wall(20.0), stamp_ns=tenth * TENTH_NS, odom_from_sensor=np.eye(4))
    assert len(history) == 3
