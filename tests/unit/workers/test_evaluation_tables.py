from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.labels import FrameLabels, MotionLabel
from workers.lab.evaluation.motion.counting import count_frame
from workers.lab.evaluation.motion.counts import LogCounts, StreamCounts, total_of
from workers.lab.evaluation.motion.table import LogEvaluation, evaluation_of
from workers.lab.evaluation.truth.objects import TrueObject, objects_in, rotations_in
from workers.lab.evaluation.truth.truth import FrameTruth

TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TRUE_DYNAMIC, TRUE_STATIC = 2, 1


def blob(count: int, *, x_m: float = 10.0) -> NDArray[np.float32]:
    return np.random.default_rng(1).normal((x_m, 2.0, 0.0), 0.1, (count, 3)).astype(np.float32)


def said(
    count: int,
    *,
    dynamic: int,
    confirmed: int | None = None,
    velocity: tuple[float, float] | None = None,
) -> FrameLabels:
    """Label the first so many points dynamic, and confirm the first so many of them."""
    labels = np.full(count, MotionLabel.STATIC, np.uint8)
    labels[:dynamic] = MotionLabel.DYNAMIC
    moves = None if velocity is None else np.array([[*velocity, 0.0]], np.float32)
    return FrameLabels(
        labels=labels,
        confidence=np.ones(count, np.float16),
        confirmed=None if confirmed is None else np.arange(count) < confirmed,
        cluster=None if velocity is None else np.zeros(count, np.int32),
        cluster_velocity_m_per_s=moves,
    )


def true(
    count: int, *, motion: int = TRUE_DYNAMIC, track: int = 4, thing: TrueObject | None = None
) -> FrameTruth:
    return FrameTruth(
        0,
        np.full(count, motion, np.uint8),
        np.full(count, track, np.int16),
        {} if thing is None else {track: thing},
        TURNED,
    )


def row_of(*counts: StreamCounts) -> LogEvaluation:
    logs = [LogCounts(frames=1, streams={"selfsupervised": each}) for each in counts]
    return evaluation_of("x", total_of(logs), stream="selfsupervised")


def test_objects_are_counted_by_class_speed_size_and_points() -> None:
    thing = TrueObject("Pedestrian", speed_m_per_s=1.3, longest_side_m=1.7)
    found = count_frame(said(30, dynamic=16), true(30, thing=thing), blob(30), log_id="a")
    missed = count_frame(said(30, dynamic=15), true(30, thing=thing), blob(30), log_id="a")
    other = count_frame(said(60, dynamic=0), true(60, thing=thing), blob(60), log_id="b")
    row = row_of(found, missed, other)
    assert row.object_recall_by_class == {"Pedestrian": pytest.approx(1 / 3, abs=1e-6)}
    assert row.object_recall_by_speed == {"0-2": pytest.approx(1 / 3, abs=1e-6)}
    assert row.object_recall_by_size == {"1.5-3": pytest.approx(1 / 3, abs=1e-6)}
    assert row.object_recall_by_points == {"20-50": 0.5, "50-100": 0.0}
    counted = row.objects_by_class["Pedestrian"]
    assert (counted.observations, counted.found) == (3, 1)
    assert (counted.tracks, counted.tracks_found) == (2, 1)


def test_an_object_that_truth_does_not_describe_is_of_unknown_class() -> None:
    row = row_of(count_frame(said(30, dynamic=30), true(30), blob(30)))
    assert row.object_recall_by_class == {"unknown": 1.0}
    assert row.object_recall_by_speed == {}


def test_confirmed_points_are_judged_on_their_own() -> None:
    row = row_of(count_frame(said(40, dynamic=40, confirmed=10), true(40), blob(40)))
    assert row.iou["80"] == 1.0
    assert row.confirmed_iou["80"] == row.confirmed_recall["80"] == 0.25
    assert row.confirmed_precision["80"] == 1.0
    assert row.confirmed_object_recall["80"] == 0.0


def test_a_false_cluster_that_is_not_confirmed_raises_no_alarm() -> None:
    static = true(40, motion=TRUE_STATIC)
    row = row_of(
        count_frame(said(40, dynamic=40, confirmed=24), static, blob(40)),
        count_frame(said(40, dynamic=40, confirmed=25), static, blob(40)),
    )
    assert row.false_clusters_per_frame == 1.0
    assert row.confirmed_false_clusters_per_frame == 0.5


def test_a_false_cluster_beyond_80_m_is_not_counted() -> None:
    row = row_of(
        count_frame(said(40, dynamic=40), true(40, motion=TRUE_STATIC), blob(40, x_m=85.0))
    )
    assert row.false_clusters_per_frame == 0.0


def test_a_stream_that_confirms_nothing_has_no_confirmed_figures() -> None:
    row = row_of(count_frame(said(40, dynamic=40), true(40), blob(40)))
    assert row.confirmed_iou == {"25": None, "50": None, "80": None}
    assert row.confirmed_false_clusters_per_frame is None


def test_velocities_are_compared_in_the_space_of_the_sensor() -> None:
    # in its own world the sensor looks along y, in odometry's along x: the same way
    thing = TrueObject("Car", velocity_m_per_s=np.array([0.0, 5.0, 0.0]))
    labels = said(30, dynamic=20, velocity=(5.0, 0.4))
    row = row_of(
        count_frame(labels, true(30, thing=thing), blob(30), odom_from_sensor=np.eye(4)),
    )
    assert row.velocity_error_m_per_s["median"] == pytest.approx(0.4, abs=0.01)
    assert row.velocity_error_m_per_s["mean"] == pytest.approx(0.4, abs=0.01)


def test_without_a_true_pose_no_velocity_is_judged() -> None:
    thing = TrueObject("Car", velocity_m_per_s=np.array([0.0, 5.0, 0.0]))
    truth = FrameTruth(0, np.full(30, 2, np.uint8), np.full(30, 4, np.int16), {4: thing}, None)
    labels = said(30, dynamic=20, velocity=(5.0, 0.4))
    row = row_of(count_frame(labels, truth, blob(30), odom_from_sensor=np.eye(4)))
    assert row.velocity_error_m_per_s == {"median": None, "mean": None, "p90": None}


def test_the_time_of_a_stage_is_the_median_of_its_frames() -> None:
    logs = [LogCounts(frames=1, stage_ms={"odometry": [t], "supervised": [t]}) for t in (1, 2, 9)]
    row = evaluation_of("x", total_of(logs), stream="selfsupervised")
    assert row.ms_per_frame == {"odometry": 2.0, "supervised": 2.0, "total": 4.0}


def test_a_truth_with_few_columns_tells_what_it_can(tmp_path: Path) -> None:
    (tmp_path / "tracks.csv").write_text("frame,track_id,class,vx,vy\n3,7,Car,3.0,4.0\n3,8,,,\n")
    objects = objects_in(tmp_path)[3]
    assert objects[7].class_name == "Car"
    assert objects[7].speed_m_per_s == 5.0
    assert objects[7].longest_side_m is None
    assert objects[8].class_name == "unknown"
    assert objects[8].velocity_m_per_s is None
    assert objects_in(tmp_path / "nowhere") == rotations_in(tmp_path / "nowhere") == {}
