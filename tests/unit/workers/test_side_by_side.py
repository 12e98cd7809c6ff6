"""Streams judged side by side: a row each, the very figures that each has alone."""

from pathlib import Path

import numpy as np
import pytest

from schemas.labels import MotionLabel
from schemas.mining import MiningSettings
from schemas.motion_rule import PAPER, PER_SECOND
from tests.factories import SMALL_LIDAR, street_log
from workers.errors import UnknownPartError
from workers.lab.evaluation.motion.counts import LogCounts, StreamCounts, total_of
from workers.lab.evaluation.motion.motion import EvaluatedFrame, evaluate_motion
from workers.lab.evaluation.motion.table import LogEvaluation, evaluation_of
from workers.lab.simulation.sensor.lidar import Lidar
from workers.paper.rigid_flow import rigid_flow
from workers.paper.scene_flow import nearest_neighbour_flow
from workers.paper.two_stage import TwoStage
from workers.paper.two_stage_tracked import TrackedTwoStage
from workers.parts.catalogue import parts_of_kind
from workers.parts.registry import build_selfsupervised

KEY = "car-7/2026-03-02/drive"
FRAMES = 4
PUBLISHED = "two-stage:nearest-neighbour:published"
SIDE_BY_SIDE = ("recorded", "two-stage", PUBLISHED)


def evaluate(
    folder: Path, stream: str | tuple[str, ...], *, frames: int = FRAMES, lidar: Lidar = SMALL_LIDAR
) -> tuple[list[LogEvaluation], list[EvaluatedFrame]]:
    log = folder / "logs" / f"{KEY}.mcap"
    if not log.exists():
        street_log(log, frames=frames, seed=4, lidar=lidar, truth=folder / "truth" / KEY)
    bucket = str(folder / "logs")
    seen: list[EvaluatedFrame] = []
    rows = evaluate_motion(
        bucket,
        folder / "truth",
        settings=MiningSettings(
            bucket=bucket, artifacts="memory://", supervised="recorded", selfsupervised="two-stage"
        ),
        stream=stream,
        on_frame=seen.append,
    )
    return rows, seen


def test_every_log_has_a_row_for_each_stream_and_so_have_all_logs_together(tmp_path: Path) -> None:
    rows, seen = evaluate(tmp_path, SIDE_BY_SIDE)
    assert [(row.log, row.stream) for row in rows] == [
        (log, stream) for log in (KEY, "all") for stream in SIDE_BY_SIDE
    ]
    assert [each.stream for each in seen] == list(SIDE_BY_SIDE) * FRAMES
    assert all(row.frames == FRAMES for row in rows)
    assert all(set(row.streams) == {row.stream} for row in rows)
    for row in rows:
        assert set(row.ms_per_frame) == {"ingest", "odometry", row.stream, "total"}


def test_side_by_side_each_stream_has_the_figures_that_it_has_alone(tmp_path: Path) -> None:
    supervised, two_stage, _ = evaluate(tmp_path, SIDE_BY_SIDE)[0][3:]
    for row, name in ((supervised, "supervised"), (two_stage, "selfsupervised")):
        *_, alone = evaluate(tmp_path, name)[0]
        assert (alone.stream, set(alone.streams)) == (name, {"supervised", "selfsupervised"})
        left_out = {"stream", "streams", "ms_per_frame"}
        assert row.model_dump(exclude=left_out) == alone.model_dump(exclude=left_out)
    assert supervised.iou["80"] == 1.0
    assert two_stage.contradicted_share is not None


def test_what_both_call_static_is_no_contradiction(tmp_path: Path) -> None:
    rows, seen = evaluate(tmp_path, ("supervised", "selfsupervised"))
    one, other = (
        np.concatenate([each.labels for each in seen if each.stream == stream])
        for stream in ("supervised", "selfsupervised")
    )
    known = (one != MotionLabel.UNKNOWN) & (other != MotionLabel.UNKNOWN)
    assert 0 < (one != other)[known].mean() < 0.9
    assert rows[-1].contradicted_share == pytest.approx((one != other)[known].mean(), abs=1e-5)


def test_streams_of_one_kind_contradict_nobody(tmp_path: Path) -> None:
    rows, _ = evaluate(tmp_path, ("two-stage", PUBLISHED))
    assert all(row.contradicted_share is None for row in rows)


def test_a_part_is_judged_by_its_own_name_and_nothing_is_run_beside_it(tmp_path: Path) -> None:
    rows, _ = evaluate(tmp_path, PUBLISHED)
    assert [set(row.streams) for row in rows] == [{PUBLISHED}] * 2


def test_a_stream_that_does_not_exist_is_refused_with_those_that_do(tmp_path: Path) -> None:
    with pytest.raises(UnknownPartError, match="no stream 'two-stag'; known: selfsupervised, sup"):
        evaluate(tmp_path, ("registration", "two-stag"))


def test_a_row_is_about_its_own_time_and_that_of_what_all_streams_need() -> None:
    logs = [
        LogCounts(
            frames=1,
            streams={"a": StreamCounts(), "b": StreamCounts()},
            stage_ms={"odometry": [t], "a": [t], "b": [10 * t]},
        )
        for t in (1, 2, 9)
    ]
    row = evaluation_of("x", total_of(logs), stream="a", others=())
    assert row.ms_per_frame == {"odometry": 2.0, "a": 2.0, "total": 4.0}


def test_every_scene_flow_is_a_stream_by_name_with_both_sets_of_numbers() -> None:
    flows = {"nearest-neighbour": nearest_neighbour_flow, "registered-clusters": rigid_flow}
    for name, flow in flows.items():
        assert build_selfsupervised(f"two-stage:{name}") == TwoStage(name, flow, PER_SECOND)
        assert build_selfsupervised(f"two-stage:{name}:published") == TwoStage(name, flow, PAPER)
    assert build_selfsupervised("two-stage") == build_selfsupervised("two-stage:nearest-neighbour")
    assert build_selfsupervised("two-stage:tracked:published") == TrackedTwoStage(PAPER)
    parts = [each for each in parts_of_kind("selfsupervised") if each.name.startswith("two-stage")]
    versions = [build_selfsupervised(part.name).version for part in parts if not part.networks]
    assert len(set(versions)) == len(versions) - 1  # the nearest neighbour has two names


def test_the_rule_on_tracked_velocities_takes_away_and_never_adds(tmp_path: Path) -> None:
    streams = ("registration", "two-stage:tracked")
    _, seen = evaluate(tmp_path, streams, frames=8, lidar=Lidar(columns=400))
    moving = kept = 0
    for before, after in zip(seen[::2], seen[1::2], strict=True):
        assert (before.name, after.confirmed) == (after.name, None)
        was, now = (each.labels == MotionLabel.DYNAMIC for each in (before, after))
        assert not (now & ~was).any()
        unknown = before.labels == MotionLabel.UNKNOWN
        assert np.array_equal(after.labels == MotionLabel.UNKNOWN, unknown)
        moving, kept = moving + int(was.sum()), kept + int(now.sum())
    assert moving > kept > 0.3 * moving
