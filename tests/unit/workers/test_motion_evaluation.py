import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.labels import FrameLabels, MotionLabel
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.factories import SMALL_LIDAR, frame, street_log
from workers.lab.evaluation.motion.counting import count_frame
from workers.lab.evaluation.motion.counts import LogCounts, total_of
from workers.lab.evaluation.motion.motion import evaluate_motion
from workers.lab.evaluation.motion.table import LogEvaluation, evaluation_of
from workers.lab.evaluation.truth.truth import FrameTruth, LogTruth, TruthUnusableError
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.faults.recorded import record
from workers.lab.simulation.sensor.lidar import sweep
from workers.lab.simulation.world.street_builder import build_street

STATIC, DYNAMIC, UNKNOWN = MotionLabel.STATIC, MotionLabel.DYNAMIC, MotionLabel.UNKNOWN
KEY = "car-7/2026-03-02/drive"
FRAMES = 8


def truth_of(motion: Sequence[int], track: Sequence[int] | None = None) -> FrameTruth:
    tracks = None if track is None else np.array(track, dtype=np.int16)
    return FrameTruth(0, np.array(motion, dtype=np.uint8), tracks)


def at_ranges(*range_m: float) -> NDArray[np.float32]:
    return np.array([(r, 0.0, 5.0) for r in range_m], dtype=np.float32)


def labels(*values: int) -> FrameLabels:
    said = np.array(values, dtype=np.uint8)
    return FrameLabels(labels=said, confidence=np.ones(len(said), np.float16))


def table(counts: LogCounts) -> LogEvaluation:
    return evaluation_of("x", counts, stream="selfsupervised")


def test_hits_false_alarms_and_misses_are_counted_under_each_range() -> None:
    counts = count_frame(
        labels(DYNAMIC, DYNAMIC, STATIC, STATIC, DYNAMIC),
        truth_of([2, 1, 2, 1, 2]),
        at_ranges(10, 20, 30, 40, 60),
    )
    near, middle, far = (counts.by_range[r] for r in (25, 50, 80))
    assert (near.hits, near.false_alarms, near.misses) == (1, 1, 0)
    assert (middle.hits, middle.false_alarms, middle.misses) == (1, 1, 1)
    assert (far.hits, far.false_alarms, far.misses) == (2, 1, 1)


def test_a_predicted_unknown_counts_as_not_dynamic() -> None:
    counts = count_frame(labels(UNKNOWN, UNKNOWN), truth_of([2, 1]), at_ranges(10, 10)).by_range[25]
    assert (counts.hits, counts.false_alarms, counts.misses, counts.unknown) == (0, 0, 1, 2)


def test_unknown_truth_is_not_judged() -> None:
    counts = count_frame(labels(DYNAMIC, STATIC), truth_of([0, 0]), at_ranges(10, 10)).by_range[80]
    assert (counts.hits, counts.false_alarms, counts.misses, counts.judged) == (0, 0, 0, 0)


def test_range_is_horizontal_and_its_limit_is_outside() -> None:
    high = np.array([[24.9, 0.0, 20.0], [25.0, 0.0, 0.0]], dtype=np.float32)
    counts = count_frame(labels(DYNAMIC, DYNAMIC), truth_of([2, 2]), high)
    assert counts.by_range[25].hits == 1
    assert counts.by_range[50].hits == 2


def test_an_object_is_found_when_more_than_half_of_its_points_are() -> None:
    track = [1] * 20 + [2] * 20 + [3] * 19
    found = [DYNAMIC] * 11 + [STATIC] * 9 + [DYNAMIC] * 10 + [STATIC] * 10 + [DYNAMIC] * 19
    counts = count_frame(labels(*found), truth_of([2] * 59, track), at_ranges(*[10.0] * 59))
    assert (counts.by_range[25].objects, counts.by_range[25].objects_found) == (2, 1)


def test_an_object_is_in_range_where_its_points_are() -> None:
    ranges = [20.0] * 15 + [30.0] * 15
    counts = count_frame(labels(*[DYNAMIC] * 30), truth_of([2] * 30, [4] * 30), at_ranges(*ranges))
    assert [counts.by_range[r].objects for r in (25, 50, 80)] == [0, 1, 1]


@pytest.mark.parametrize(
    ("truth", "points", "expected"),
    [
        pytest.param(1, 40, 1, id="a static blob called dynamic"),
        pytest.param(2, 40, 0, id="a mover"),
        pytest.param(0, 40, 0, id="of unknown truth"),
        pytest.param(1, 24, 0, id="too few points"),
    ],
)
def test_a_false_cluster_is_large_and_holds_nothing_that_moves(
    truth: int, points: int, expected: int
) -> None:
    blob = np.random.default_rng(1).normal((10.0, 2.0, 0.0), 0.1, (points, 3)).astype(np.float32)
    counts = count_frame(labels(*[DYNAMIC] * points), truth_of([truth] * points), blob)
    assert counts.false_clusters == expected


def test_ratios_come_of_summed_counts_and_a_ratio_of_nothing_is_null() -> None:
    logs = []
    for answers, motion in (((1, 1, 0, 1), (2, 2, 2, 1)), ((1, 0), (2, 1))):
        counted = LogCounts(frames=1)
        counted.streams["selfsupervised"] = count_frame(
            labels(*answers), truth_of(motion), at_ranges(*[30.0] * len(motion))
        )
        logs.append(counted)
    row = table(total_of(logs))
    assert row.iou == {"25": None, "50": 0.6, "80": 0.6}
    assert row.precision == {"25": None, "50": 0.75, "80": 0.75}
    assert row.recall == {"25": None, "50": 0.75, "80": 0.75}
    assert row.object_recall["50"] is None
    assert row.contradicted_share is None
    assert table(LogCounts()).iou["50"] is None


def simulated(folder: Path, *, failures: Sequence[PlantedFailure] = ()) -> tuple[str, Path]:
    street_log(
        folder / "logs" / f"{KEY}.mcap",
        frames=FRAMES,
        seed=4,
        failures=failures,
        truth=folder / "truth" / KEY,
    )
    return str(folder / "logs"), folder / "truth"


def evaluate(bucket: str, truth: Path, *frames: int | None) -> list[LogEvaluation]:
    first, last = frames or (0, None)
    return evaluate_motion(
        bucket,
        truth,
        frames=(first or 0, last),
        settings=MiningSettings(bucket=bucket, artifacts="memory://", supervised="recorded"),
        stream="supervised",
        both=False,
    )


def test_a_model_without_mistakes_has_an_iou_of_one(tmp_path: Path) -> None:
    log, everything = evaluate(*simulated(tmp_path))
    assert (log.log, everything.log) == (KEY, "all")
    assert log.frames == everything.frames == FRAMES
    assert log.iou["80"] == log.precision["80"] == log.recall["80"] == 1.0
    assert log.streams["supervised"].iou == log.iou


def test_a_missed_mover_costs_exactly_its_points_in_the_frames_judged(tmp_path: Path) -> None:
    street = build_street(4, seconds=FRAMES * SMALL_LIDAR.period_s, style="drives")
    frames = [sweep(street, SMALL_LIDAR, index) for index in range(FRAMES)]
    moving = np.concatenate([seen.track[seen.motion == 2] for seen in frames])
    most = int(np.bincount(moving).argmax())
    failure = PlantedFailure(FailureKind.MISSED_MOVER, most, 0.35, 0.65)
    row, _ = evaluate(*simulated(tmp_path, failures=[failure]), 3, 7)

    hits = misses = 0
    for seen in frames[3:7]:
        said = record(street, seen, [failure])
        near = np.hypot(*seen.points_m[:, :2].T) < 80
        hits += int(((seen.motion == 2) & (said.motion == 2) & near).sum())
        misses += int(((seen.motion == 2) & (said.motion != 2) & near).sum())
    assert misses > 0
    assert row.frames == 4
    assert row.recall["80"] == pytest.approx(hits / (hits + misses), abs=1e-6)
    assert row.precision["80"] == 1.0


def test_frames_are_clipped_at_the_end_of_the_log(tmp_path: Path) -> None:
    row, _ = evaluate(*simulated(tmp_path), 5, 500)
    assert row.frames == FRAMES - 5
    row, _ = evaluate(*simulated(tmp_path), 50, 60)
    assert row.frames == 0
    assert row.iou == {"25": None, "50": None, "80": None}


def test_truth_of_a_split_recording_goes_on_in_the_folder_of_the_next_part(tmp_path: Path) -> None:
    for part in range(2):
        street_log(
            tmp_path / "logs" / f"{KEY}_{part}.mcap",
            frames=3,
            truth=tmp_path / "truth" / f"{KEY}_{part}",
            start_ns=1_772_445_600_000_000_000 + part * 300_000_000,
        )
    bucket = str(tmp_path / "logs")
    (recording,) = group_recordings(open_bucket(bucket).list())
    truth = LogTruth.beside(recording, tmp_path / "truth")
    assert truth is not None
    assert len(truth) == 6
    row, _ = evaluate(bucket, tmp_path / "truth")
    assert (row.log, row.frames) == (KEY, 6)
    assert row.iou["80"] == 1.0


def test_truth_without_a_list_of_frames_is_taken_in_order(tmp_path: Path) -> None:
    bucket, truth = simulated(tmp_path)
    (truth / KEY / "frames.json").unlink()
    row, _ = evaluate(bucket, truth)
    assert row.frames == FRAMES
    assert row.iou["80"] == 1.0


def test_a_frame_without_truth_is_passed_over(tmp_path: Path) -> None:
    bucket, truth = simulated(tmp_path)
    (truth / KEY / "000002.npz").unlink()
    assert evaluate(bucket, truth)[0].frames == FRAMES - 1


def test_truth_of_another_log_is_refused(tmp_path: Path) -> None:
    bucket, truth = simulated(tmp_path)
    other = tmp_path / "other" / KEY
    street_log(tmp_path / "other.mcap", frames=2, seed=9, truth=other, start_ns=5_000_000_000)
    with pytest.raises(TruthUnusableError, match="knows no frame of stamp 17724456"):
        evaluate(bucket, tmp_path / "other")
    shutil.copy(other / "000000.npz", truth / KEY / "000000.npz")
    with pytest.raises(TruthUnusableError, match=r"truth labels \d+ points, frame 0 has"):
        evaluate(bucket, truth)


def test_a_bucket_without_truth_is_refused(tmp_path: Path) -> None:
    bucket, _ = simulated(tmp_path)
    with pytest.raises(TruthUnusableError, match=r"no log of .* has truth in"):
        evaluate(bucket, tmp_path / "nowhere")


def test_truth_finds_a_frame_by_its_stamp_when_an_earlier_one_could_not_be_read(
    tmp_path: Path,
) -> None:
    bucket, truth_folder = simulated(tmp_path)
    (recording,) = group_recordings(open_bucket(bucket).list())
    truth = LogTruth.beside(recording, truth_folder)
    assert truth is not None
    stamps = [
        row["header_stamp"]
        for row in json.loads((truth_folder / KEY / "frames.json").read_text())["frames"]
    ]
    late = frame([(1.0, 0.0, 0.0)], stamp_ns=stamps[5])
    assert truth.number_of(late, position=4) == 5
