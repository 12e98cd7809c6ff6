import time

import numpy as np
import pytest
from sklearn.cluster import DBSCAN

from schemas.contradiction import ContradictionKind, LabelledFrame, Scene
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from tests.labelled_worlds import CLASS_NAMES, START_NS, Thing, labelled_frame
from workers.contradiction.agreement import compare
from workers.contradiction.boxes import fit_box
from workers.contradiction.instances import cluster_places, find_instances
from workers.contradiction.settings import PAPER_INSTANCES, InstanceSettings

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
MISSED = ContradictionKind.ONLY_PREDICTIVE_DYNAMIC
PHANTOM = ContradictionKind.ONLY_SEMANTIC_DYNAMIC
BLOBS = ((0, 0, 300), (6, 0, 40), (-8, 5, 2000), (20, -9, 15), (0, 40, 60))


def _scene(*things: Thing, ground: bool = True, classes: bool = True) -> Scene:
    return Scene("log/lidar/0", (labelled_frame(things, ground=ground, classes=classes),))


def test_a_missed_car_and_a_phantom_next_to_it_are_two_instances_of_two_kinds() -> None:
    scene = _scene(
        Thing((10, 3, 0), STATIC, DYNAMIC), Thing((10, 0.5, 0), DYNAMIC, STATIC, class_id=2)
    )
    phantom, missed = find_instances(scene, class_names=CLASS_NAMES)
    assert (phantom.kind.name, phantom.class_name) == (PHANTOM, "pedestrian")
    assert (missed.kind.name, missed.class_name) == (MISSED, "car")


def test_points_with_equal_labels_make_no_instance() -> None:
    scene = _scene(
        Thing((10, 0, 0), STATIC, STATIC),
        Thing((20, 0, 0), DYNAMIC, DYNAMIC),
        Thing((30, 0, 0), UNKNOWN, DYNAMIC),
    )
    assert find_instances(scene, class_names=CLASS_NAMES) == ()


def test_an_instance_knows_its_points_box_and_both_confidences() -> None:
    wall = Thing((5, 9, 0), STATIC, STATIC, points=50, size_m=(8, 0.2, 3))
    car = Thing((10, 3, 0.5), STATIC, DYNAMIC, points=400, confidence=0.75)
    (instance,) = find_instances(_scene(wall, car), class_names=CLASS_NAMES)
    assert instance.point_index.tolist() == list(range(50, 450))
    np.testing.assert_allclose(instance.centre_m, (10, 3, 0.5), atol=0.1)
    np.testing.assert_allclose(instance.size_m, (4, 1.8, 1.5), atol=0.15)
    assert instance.semantic_confidence == instance.predictive_confidence == 0.75
    assert instance.frame_index == 0


def test_an_instance_has_the_mean_velocity_of_the_clusters_it_is_made_of() -> None:
    scene = _scene(
        Thing((10, 0, 0), STATIC, DYNAMIC, points=100, velocity_m_per_s=(8, 0, 0)),
        Thing((13, 0, 0), STATIC, DYNAMIC, points=300, velocity_m_per_s=(4, 0, 0)),
    )
    (instance,) = find_instances(scene, class_names=CLASS_NAMES)
    np.testing.assert_allclose(instance.velocity_m_per_s, (5, 0, 0))


def test_streams_without_ground_classes_or_clusters_give_instances_all_the_same() -> None:
    things = (Thing((10, 0, 0), STATIC, DYNAMIC),)
    (instance,) = find_instances(_scene(*things, ground=False, classes=False), class_names=())
    assert instance.class_name == ""


def test_labels_that_bleed_onto_the_ground_are_no_instance() -> None:
    road = Thing((10, 0, -2), DYNAMIC, STATIC, size_m=(4, 2, 0.05), ground=True)
    assert find_instances(_scene(road), class_names=CLASS_NAMES) == ()


def test_a_car_far_away_with_a_dozen_points_is_kept_and_a_handful_of_specks_is_not() -> None:
    far = Thing((70, 0, 0), STATIC, DYNAMIC, points=12, size_m=(1.5, 1.5, 1))
    specks = Thing((20, 0, 0), STATIC, DYNAMIC, points=8, size_m=(1, 1, 1))
    (instance,) = find_instances(_scene(far, specks), class_names=CLASS_NAMES)
    assert len(instance.point_index) == 12


def test_the_rim_of_an_agreed_mover_differs_from_an_isolated_object() -> None:
    alone = Thing((10, 20, 0), STATIC, DYNAMIC, points=60, size_m=(1, 1, 1))
    rim = Thing((10, 0, -0.5), STATIC, DYNAMIC, points=60, size_m=(4, 1.8, 0.3))
    body = Thing((10, 0, 0), DYNAMIC, DYNAMIC, points=800)
    by_y = sorted(
        find_instances(_scene(alone, rim, body), class_names=CLASS_NAMES),
        key=lambda instance: float(instance.centre_m[1]),
    )
    assert by_y[0].own_share < 0.2
    assert by_y[1].own_share == 1.0


def test_clusters_over_places_are_those_of_dbscan_over_points() -> None:
    rng = np.random.default_rng(7)
    blobs = [rng.normal((x, y, 0), (0.6, 0.3, 0.3), (n, 3)) for x, y, n in BLOBS]
    points_m = np.concatenate([*blobs, rng.uniform(-60, 60, (60, 3))]).astype(np.float32)
    settings = InstanceSettings()
    ours = cluster_places(points_m, settings=settings)
    plain = DBSCAN(eps=settings.eps_m, min_samples=settings.min_points).fit_predict(points_m)
    both = (ours >= 0) & (plain >= 0)
    assert len(set(ours[ours >= 0].tolist())) == len(BLOBS)
    assert (ours >= 0).sum() == pytest.approx((plain >= 0).sum(), abs=6)
    assert len(set(zip(ours[both].tolist(), plain[both].tolist(), strict=True))) == len(BLOBS)


def test_in_the_papers_form_every_point_counts_for_itself() -> None:
    rng = np.random.default_rng(5)
    points = rng.normal(0, 0.5, (400, 3)).astype(np.float32)
    points[200:] += np.float32(1.8)
    expected = DBSCAN(eps=1.0, min_samples=25).fit_predict(points)
    np.testing.assert_array_equal(cluster_places(points, settings=PAPER_INSTANCES), expected)
    assert (cluster_places(points[:24], settings=PAPER_INSTANCES) == -1).all()


def test_a_stream_that_fails_on_a_whole_frame_costs_little_time() -> None:
    rng = np.random.default_rng(3)
    n = 100_000
    points_m = (rng.normal(0, 1, (n, 3)) * (18, 18, 1)).astype(np.float32)
    zeros = np.zeros(n, dtype=np.uint8)
    sure = np.ones(n, dtype=np.float16)
    frame = LidarFrame(
        log_id="log",
        stamp_ns=START_NS,
        points_m=points_m,
        intensity=np.zeros(n, dtype=np.float32),
        offset_ns=np.zeros(n, dtype=np.int32),
        ring=np.zeros(n, dtype=np.int16),
        valid_mask=np.ones(n, dtype=np.bool_),
    )
    labelled = LabelledFrame(
        PosedFrame(frame, np.eye(4)),
        FrameLabels(zeros, sure),
        FrameLabels(zeros + np.uint8(1), sure),
        compare(zeros, zeros + np.uint8(1)),
    )
    before_s = time.process_time()
    instances = find_instances(Scene("log/lidar/0", (labelled,)), class_names=())
    assert time.process_time() - before_s < 5.0  # without coarser places: minutes, gigabytes
    assert sum(len(instance.point_index) for instance in instances) > 0.8 * n


def test_a_wild_return_at_ten_kilometres_changes_nothing() -> None:
    car = Thing((10, 0, 0), STATIC, DYNAMIC)
    wild = Thing((9e3, 9e3, 9e3), STATIC, DYNAMIC, points=20)
    (alone,) = find_instances(_scene(car), class_names=CLASS_NAMES)
    (beside,) = find_instances(_scene(car, wild), class_names=CLASS_NAMES)
    assert alone.point_index.tolist() == beside.point_index.tolist()


@pytest.mark.parametrize("yaw_rad", [-1.4, -0.5, 0.0, 0.7, 1.3])
def test_a_box_has_the_heading_of_its_longer_side(yaw_rad: float) -> None:
    rng = np.random.default_rng(1)
    flat = rng.uniform(-0.5, 0.5, (600, 3)) * (5, 2, 1.5)
    turn = np.array([[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]])
    flat[:, :2] = flat[:, :2] @ turn.T
    centre_m, size_m, found_rad = fit_box((flat + np.array((7, -3, 1))).astype(np.float32))
    assert found_rad == pytest.approx(yaw_rad, abs=np.deg2rad(3))
    np.testing.assert_allclose(size_m, (5, 2, 1.5), atol=0.2)
    np.testing.assert_allclose(centre_m, (7, -3, 1), atol=0.1)


def test_a_single_point_has_a_box_without_extent() -> None:
    centre_m, size_m, _ = fit_box(np.array([[1, 2, 3]], dtype=np.float32))
    np.testing.assert_allclose(centre_m, (1, 2, 3), atol=1e-6)
    np.testing.assert_allclose(size_m, 0, atol=1e-6)


def test_an_instance_has_the_share_of_its_points_with_confirmed_motion() -> None:
    missed = Thing((10, 3, 0), STATIC, DYNAMIC, points=100, confirmed_share=0.3)
    phantom = Thing((-10, 3, 0), DYNAMIC, STATIC)
    of_phantom, of_missed = find_instances(_scene(missed, phantom), class_names=CLASS_NAMES)
    assert of_missed.confirmed_share == pytest.approx(0.3)
    assert of_phantom.confirmed_share is None
    untold = Thing((10, 3, 0), STATIC, DYNAMIC)
    (instance,) = find_instances(_scene(untold), class_names=CLASS_NAMES)
    assert instance.confirmed_share is None
