from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from schemas.arrays import Points
from workers.lidar.range_image import SensorProfile, image_channels, project

EVEN = SensorProfile(name="even", rows=4, columns=8, fov_up_deg=10, fov_down_deg=-10)
BEAMS = replace(EVEN, name="beams", elevations_deg=(9.0, 1.0, 0.0, -9.0))
KITTI360 = SensorProfile(
    name="kitti360",
    rows=64,
    columns=2048,
    fov_up_deg=3,
    fov_down_deg=-25,
    clamp=True,
    means=(11.27, -0.01, 0.27, -1.01, 0.30),
    stds=(9.70, 12.14, 8.48, 0.84, 0.15),
)


def _points(*rows: tuple[float, float, float]) -> Points:
    return np.array(rows, dtype=np.float32)


def _at(elevation_deg: float, *, range_m: float = 10.0, azimuth_deg: float = 0.0) -> Points:
    up, left = np.radians(elevation_deg), np.radians(azimuth_deg)
    flat = np.cos(up) * range_m
    return _points((flat * np.cos(left), flat * np.sin(left), np.sin(up) * range_m))


def test_the_nearest_of_two_points_in_one_pixel_is_seen_and_both_know_their_pixel() -> None:
    image = project(_points((20, 0.1, 0), (10, 0.1, 0)), EVEN)
    assert image.index[image.row[0], image.column[0]] == 1
    assert (image.row[0], image.column[0]) == (image.row[1], image.column[1])
    assert_allclose(image.range_m[image.index >= 0], np.hypot(10, 0.1), rtol=1e-6)


def test_of_two_equally_near_points_the_first_is_seen() -> None:
    image = project(_points((10, 0.1, 0), (10, 0.1, 0)), EVEN)
    assert image.index.max() == 0


def test_the_very_first_point_is_seen_too() -> None:
    assert (project(_points((10, 0.1, 0)), EVEN).index == 0).sum() == 1


@pytest.mark.parametrize(
    ("azimuth_deg", "column"),
    [
        pytest.param(179, 0, id="behind, from the left"),
        pytest.param(90, 2, id="left"),
        pytest.param(-1, 4, id="ahead, just right of the middle"),
        pytest.param(-90, 6, id="right"),
        pytest.param(-179, 7, id="behind, from the right"),
    ],
)
def test_columns_run_clockwise_from_behind(azimuth_deg: float, column: int) -> None:
    assert project(_at(1, azimuth_deg=azimuth_deg), EVEN).column.tolist() == [column]


@pytest.mark.parametrize(
    ("elevation_deg", "row"), [(9.9, 0), (4.9, 1), (-4.9, 2), (-9.9, 3), (11, -1), (-11, -1)]
)
def test_rows_run_from_the_top_and_what_is_outside_the_view_has_none(
    elevation_deg: float, row: int
) -> None:
    assert project(_at(elevation_deg), EVEN).row.tolist() == [row]


@pytest.mark.parametrize(("elevation_deg", "row"), [(11, 0), (-11, 3)])
def test_a_clamping_profile_keeps_what_is_outside_the_view(elevation_deg: float, row: int) -> None:
    assert project(_at(elevation_deg), replace(EVEN, clamp=True)).row.tolist() == [row]


@pytest.mark.parametrize(
    ("elevation_deg", "row"), [(9.5, 0), (5.1, 0), (4.9, 1), (0.6, 1), (0.4, 2), (-4.4, 2), (-5, 3)]
)
def test_a_point_belongs_to_the_nearest_beam(elevation_deg: float, row: int) -> None:
    assert project(_at(elevation_deg), BEAMS).row.tolist() == [row]


def test_returns_that_are_none_have_no_pixel() -> None:
    nan, inf = float("nan"), float("inf")
    points = _points((0, 0, 0), (nan, 1, 1), (inf, 0, 0), (10, 0, 0), (12, 0, 0))
    image = project(points, EVEN, valid_mask=np.array([True, True, True, False, True]))
    assert image.projected_mask.tolist() == [False, False, False, False, True]
    assert sorted(np.unique(image.index)) == [-1, 4]
    assert np.isfinite(image.point_range_m).all()


def test_a_gate_leaves_out_the_near_and_the_far() -> None:
    points = _points((1, 0, 0), (5, 0, 0), (50, 0, 0))
    assert project(points, EVEN, gate_m=(2, 50)).projected_mask.tolist() == [False, True, False]


def test_an_empty_frame_is_an_empty_image() -> None:
    image = project(np.zeros((0, 3), dtype=np.float32), EVEN)
    assert (image.index == -1).all()
    assert (image.range_m == -1).all()


def test_channels_are_normalised_and_empty_pixels_are_zero() -> None:
    profile = replace(EVEN, means=(10, 0, 0, 0, 0.5), stds=(2, 1, 1, 1, 0.25))
    points = _points((12, 0.1, 0))
    image = project(points, profile)
    channels = image_channels(image, points, np.array([1.0], dtype=np.float32), profile)
    assert_allclose(channels[:, image.index == 0].T, [[1, 12, 0.1, 0, 2]], atol=1e-3)
    assert (channels[:, image.index < 0] == 0).all()


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"rows": 0}, id="no rows"),
        pytest.param({"fov_up_deg": -20.0}, id="upside down"),
        pytest.param({"stds": (1, 1, 1, 1, 0)}, id="nothing varies"),
        pytest.param({"means": (1.0,)}, id="too few means"),
        pytest.param({"elevations_deg": (1.0, 0.0)}, id="too few beams"),
        pytest.param({"elevations_deg": (0.0, 1.0, 2.0, 3.0)}, id="beams rise"),
    ],
)
def test_a_profile_that_no_image_can_have_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="profile 'even'"):
        replace(EVEN, **change)  # type: ignore[arg-type]
