from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from schemas.arrays import Points
from schemas.camera import CameraCalibration
from tests.golden.conjugation import conjugate
from workers.lidar.fidelity import Form
from workers.lidar.range_image import SensorProfile, image_channels, project
from workers.paper.camera_filter import camera_filter, from_flow_space, to_flow_space
from workers.paper.ground_rule import GROUND, NOT_GROUND, OUTSIDE, ground_labels
from workers.paper.pillars import GNDNET_GRID, pillars
from workers.points.se3 import inverse
from workers.supervised.paper_residuals import PaperResiduals
from workers.supervised.residual_image import ResidualSettings, with_residuals

EVEN = SensorProfile(name="even", rows=4, columns=8, fov_up_deg=10, fov_down_deg=-10)
AXES = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, -0.3], [0, 0, 0, 1]], np.float64)
CAMERA = CameraCalibration.of(
    np.array([[500, 0, 320, 0], [0, 500, 240, 0], [0, 0, 1, 0]], np.float64),
    AXES,
    width=640,
    height=480,
)
BOTH = pytest.mark.parametrize("form", list(Form))


def _points(*rows: tuple[float, float, float]) -> Points:
    return np.array(rows, dtype=np.float32)


def test_as_published_the_first_point_is_not_seen_but_keeps_its_pixel() -> None:
    points = _points((10, 0.1, 0), (0.1, 10, 0))
    paper, corrected = (project(points, EVEN, form=form) for form in (Form.PAPER, Form.CORRECTED))
    np.testing.assert_array_equal(paper.index, corrected.index)
    assert corrected.seen_mask.sum() == 2
    assert paper.index[paper.seen_mask].tolist() == [1]
    channels = image_channels(paper, points, np.ones(2, np.float32), EVEN)
    assert (channels[:, paper.index == 0] == 0).all()


def test_as_published_what_is_above_the_view_lies_in_the_first_row() -> None:
    points = _points((10, 0, 9), (10, 0, -9))
    assert project(points, EVEN, form=Form.PAPER).row.tolist() == [0, 3]
    assert project(points, EVEN).row.tolist() == [-1, -1]
    assert project(points, replace(EVEN, clamp=True)).row.tolist() == [0, 3]


def test_in_double_precision_the_nearer_of_two_points_is_told_apart() -> None:
    points = np.array([(10.0000003, 0.1, 0.0), (10.0, 0.1, 0.0)])
    image = project(points, EVEN, precision=np.float64)
    assert image.index.max() == 1
    assert image.range_m.dtype == np.float32


def test_residuals_are_laid_out_behind_the_channels_where_something_is_seen() -> None:
    points = _points((10, 0.1, 0), (0.1, 10, 0))
    image = project(points, EVEN, form=Form.PAPER)
    channels = image_channels(image, points, np.ones(2, np.float32), EVEN)
    stacked = with_residuals(image, channels, np.ones((3, 4, 8), np.float32))
    assert stacked.shape == (8, 4, 8)
    assert stacked[5:].sum() == 3


def test_as_published_past_frames_count_by_number_whatever_the_time() -> None:
    residuals = PaperResiduals(EVEN, ResidualSettings(ages_s=(0.1, 0.2)))
    wall = _points(*((10, y, 0) for y in np.linspace(-3, 3, 200)))
    ahead = np.eye(4)
    ahead[0, 3] = 1.0
    assert (residuals(wall, np.eye(4)) == 0).all()
    first = residuals(wall, np.eye(4))
    assert (first == 0).all()
    second = residuals(wall, ahead)  # 1 m farther on, a wall still 10 m away has moved on as well
    assert np.median(second[0][second[0] > 0]) == pytest.approx(0.1, abs=0.01)
    np.testing.assert_array_equal(second[0], second[1])


@BOTH
def test_only_what_is_seen_near_and_off_the_ground_is_kept(form: Form) -> None:
    points = _points((10, 0, 0), (10, 0, -1), (10, 30, 0), (-10, 0, 0), (60, 0, 0), (10, 1, 0))
    ground = np.array([1, 0, 1, 1, 1, -1], np.int8)
    left = camera_filter(points, ground, CAMERA, form=form)
    assert left.in_view.tolist() == [0, 1, 4, 5]
    assert left.in_range.tolist() == [0, 1, 5]
    assert left.kept.tolist() == [0]


def test_a_point_between_lidar_and_camera_is_not_mirrored_into_the_image() -> None:
    between = _points((0.2, 0.01, 0.01))
    ground = np.array([1], np.int8)
    assert len(camera_filter(between, ground, CAMERA, form=Form.PAPER).kept) == 1
    assert len(camera_filter(between, ground, CAMERA).kept) == 0


def test_near_is_25_m_around_and_as_published_a_box_of_35_m() -> None:
    points, ground = _points((24, 0, 0), (26, 0, 0), (24, 12, 0)), np.ones(3, np.int8)
    assert camera_filter(points, ground, CAMERA).kept.tolist() == [0]
    assert camera_filter(points, ground, CAMERA, form=Form.PAPER).kept.tolist() == [0, 1, 2]


def test_the_rectifying_rotation_counts_in_the_corrected_form_only() -> None:
    turned = np.eye(4)
    turned[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]  # the camera really looks aside
    calibration = CAMERA.model_copy(update={"rectified_from_camera": turned.tolist()})
    points, ground = _points((10, 0, 0)), np.ones(1, np.int8)
    assert len(camera_filter(points, ground, calibration).kept) == 0
    assert len(camera_filter(points, ground, calibration, form=Form.PAPER).kept) == 1


def test_the_space_of_the_flow_is_left_up_ahead_and_the_way_back_returns() -> None:
    points = _points((10, 2, 1))
    there = to_flow_space(points, CAMERA)
    assert_allclose(there, [[2, 1, 9.7]], atol=1e-6)
    assert_allclose(from_flow_space(there, CAMERA), points, atol=1e-6)


def test_pillars_keep_the_first_points_and_the_order_of_their_first() -> None:
    grid = replace(GNDNET_GRID, max_points=2)
    points = _points((5.5, 5.5, 0), (0.5, 0.5, 0), (5.6, 5.6, 0), (5.7, 5.7, 0), (99, 0, 0))
    found = pillars(points, np.arange(5, dtype=np.float32), grid=grid)
    assert found.coordinates_zyx.tolist() == [[0, 55, 52], [0, 50, 47]]
    assert found.counts.tolist() == [2, 1]
    assert found.points[0, :, 3].tolist() == [0, 2]
    assert_allclose(found.points[0, 0], [5.5, 5.5, 1.733, 0], atol=1e-6)


def test_no_more_pillars_stand_than_are_allowed() -> None:
    points = _points(*((x + 0.5, 0.5, 0) for x in range(10)))
    found = pillars(points, np.zeros(10, np.float32), grid=replace(GNDNET_GRID, max_pillars=3))
    assert found.coordinates_zyx[:, 2].tolist() == [47, 48, 49]
    assert len(pillars(points[:0], np.zeros(0, np.float32)).counts) == 0


def test_points_rise_above_the_cell_they_stand_on_and_as_published_above_one_beside() -> None:
    elevation = np.zeros((100, 100))
    elevation[50, 57] = 1.0  # x from 10 to 11 m, y from 0 to 1 m
    points = _points((10.5, 0.5, -1.0), (7.5, 0.5, -1.0), (0, 60, 0), (-46.5, 0.5, -1.0))
    assert ground_labels(points, elevation).tolist() == [GROUND, NOT_GROUND, OUTSIDE, NOT_GROUND]
    paper = ground_labels(points, elevation, form=Form.PAPER)
    assert paper.tolist() == [NOT_GROUND, GROUND, OUTSIDE, NOT_GROUND]
    edge = _points((-46.5, -49.5, 0), (-49.9, 0, 0))
    assert ground_labels(edge, elevation).tolist() == [NOT_GROUND, OUTSIDE]
    assert ground_labels(edge, elevation, form=Form.PAPER).tolist() == [OUTSIDE, OUTSIDE]


def test_an_elevation_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="elevation must be"):
        ground_labels(_points((0, 0, 0)), np.zeros((10, 10)))


def test_a_motion_said_in_another_space_moves_the_same_things() -> None:
    ahead = np.eye(4)
    ahead[0, 3] = 2.0
    seen = conjugate(AXES, ahead)
    assert_allclose(seen[:3, 3], [0, 0, 2], atol=1e-12)
    assert_allclose(conjugate(inverse(AXES), seen), ahead, atol=1e-12)
