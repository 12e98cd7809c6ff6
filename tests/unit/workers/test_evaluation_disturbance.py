from pathlib import Path

import numpy as np
import pytest

from schemas.labels import MotionLabel
from schemas.mining import MiningSettings
from tests.factories import frame, posed, street_log
from workers.errors import LogUnusableError
from workers.lab.evaluation.motion.beam_rows import BeamRows
from workers.lab.evaluation.motion.disturbance import (
    Disturbance,
    NumberedFrame,
    with_yaw_noise,
    without_beams,
)
from workers.lab.evaluation.motion.motion import EvaluatedFrame, evaluate_motion
from workers.lab.evaluation.motion.worst_frames import WorstFrames
from workers.lab.evaluation.motion.written_labels import write_labels

KEY = "car-7/2026-03-02/drive"
FRAMES = 8
ELEVATIONS = np.radians([-10.0, -6.0, -2.0, 0.0, 4.0])


def cloud(*, by_beam: bool = True, azimuths: int = 90) -> np.ndarray:
    """Points at 20 m, beam after beam (from the top one down) or step after step of azimuth."""
    azimuth, elevation = np.meshgrid(
        np.linspace(0.05, 2 * np.pi - 0.05, azimuths), ELEVATIONS[::-1]
    )
    points = 20.0 * np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)], axis=-1)
    if not by_beam:
        points = points.transpose(1, 0, 2)
    return points.reshape(-1, 3).astype(np.float32)


def judged(*, wrong: int, name: str = "x/y/000000") -> EvaluatedFrame:
    labels = np.full(20, MotionLabel.STATIC, np.uint8)
    labels[:wrong] = MotionLabel.DYNAMIC
    labels[-1] = MotionLabel.UNKNOWN
    return EvaluatedFrame(
        stream="selfsupervised",
        log_id="x/y",
        name=name,
        points_m=np.full((20, 3), 5.0, np.float32),
        labels=labels,
        confirmed=labels == MotionLabel.DYNAMIC,
        truth=np.ones(20, np.uint8),
        kept=None,
    )


@pytest.mark.parametrize("recorded", [True, False])
def test_rows_are_counted_from_the_lowest_beam_up(recorded: bool) -> None:
    ring = np.repeat(np.arange(5), 90).astype(np.int16) if recorded else np.full(450, -1, np.int16)
    whole = frame(cloud(), ring=ring)
    beams = BeamRows.of(whole)
    assert len(beams) == 5
    assert np.allclose(np.arctan(beams.tangents), ELEVATIONS, atol=1e-6)
    assert beams.rows_of(whole)[::90].tolist() == [4, 3, 2, 1, 0]

    (kept,) = without_beams([NumberedFrame(0, whole, whole)], slice(1, None, 2))
    assert len(kept.frame) == 180
    assert kept.kept is not None
    assert np.array_equal(kept.frame.points_m, whole.points_m[kept.kept])
    elevations = np.unique(np.degrees(np.arctan2(kept.frame.points_m[:, 2], 20.0)).round())
    assert elevations.tolist() == [-6.0, 0.0]


def test_a_cloud_that_names_no_beams_and_is_not_in_their_order_is_refused() -> None:
    whole = frame(cloud(by_beam=False), ring=np.full(450, -1, np.int16))
    with pytest.raises(LogUnusableError, match="cannot leave out beams"):
        list(without_beams([NumberedFrame(0, whole, whole)], slice(0, None, 2)))


def test_yaw_noise_belongs_to_the_frame_whatever_came_before_it() -> None:
    poses = [posed(frame([(5.0, 0.0, 0.0)])) for _ in range(200)]
    noisy = list(with_yaw_noise(poses, range(200), 0.5))
    (again,) = with_yaw_noise(poses[:1], [7], 0.5)
    assert np.array_equal(again.odom_from_sensor, noisy[7].odom_from_sensor)
    yaw_deg = [np.degrees(np.arctan2(*each.odom_from_sensor[1::-1, 0])) for each in noisy]
    assert np.std(yaw_deg) == pytest.approx(0.5, rel=0.15)
    assert list(with_yaw_noise(poses, range(200), 0.0)) == poses


def evaluate(folder: Path, disturbance: Disturbance) -> tuple[list[EvaluatedFrame], float | None]:
    logs = folder / "logs" / f"{KEY}.mcap"
    if not logs.exists():
        street_log(logs, frames=FRAMES, seed=4, truth=folder / "truth" / KEY)
    bucket = str(folder / "logs")
    seen: list[EvaluatedFrame] = []
    *_, everything = evaluate_motion(
        bucket,
        folder / "truth",
        settings=MiningSettings(bucket=bucket, artifacts="memory://", supervised="recorded"),
        stream="supervised",
        both=False,
        disturbance=disturbance,
        on_frame=seen.append,
    )
    assert everything.frames == len(seen)
    return seen, everything.iou["80"]


def test_dropped_frames_are_not_judged_and_the_others_keep_their_numbers(tmp_path: Path) -> None:
    seen, iou = evaluate(tmp_path, Disturbance(every=3))
    assert [each.name for each in seen] == [f"{KEY}/{number:06d}" for number in (0, 3, 6)]
    assert iou == 1.0


def test_labels_are_written_for_every_recorded_point_in_codes_of_the_truth(tmp_path: Path) -> None:
    whole, _ = evaluate(tmp_path, Disturbance())
    halved, iou = evaluate(tmp_path, Disturbance(rows=slice(0, None, 2)))
    assert iou == 1.0
    for each, half in zip(whole, halved, strict=True):
        with np.load(write_labels(tmp_path / "all", each)) as arrays:
            motion = arrays["motion"]
            assert set(arrays) == {"motion", "confirmed"}
            assert not arrays["confirmed"].any()
        with np.load(tmp_path / "truth" / f"{each.name}.npz") as arrays:
            assert np.array_equal(motion == 2, arrays["motion"] == 2)
        with np.load(write_labels(tmp_path / "half", half)) as arrays:
            kept = arrays["kept"]
            assert 0 < kept.sum() < len(kept) == len(motion)
            assert np.array_equal(arrays["motion"][kept], motion[kept])
            assert not arrays["motion"][~kept].any()


def test_confirmed_points_and_unknown_ones_are_written_as_such(tmp_path: Path) -> None:
    path = write_labels(tmp_path, judged(wrong=3, name="x/y/000042"))
    assert path == tmp_path / "x" / "y" / "000042.npz"
    with np.load(path) as arrays:
        assert arrays["motion"].tolist() == [2] * 3 + [1] * 16 + [0]
        assert arrays["confirmed"].tolist() == [True] * 3 + [False] * 17


def test_the_worst_frames_are_those_with_most_wrong_points() -> None:
    worst = WorstFrames(2)
    for number, wrong in enumerate((1, 5, 0, 5, 9)):
        worst.add(judged(wrong=wrong, name=f"x/y/{number:06d}"))
    assert [each.name for each in worst.frames] == ["x/y/000004", "x/y/000001"]
