"""Converters of data sets on made-up folders: points, poses, truth, labels, cameras, restarts."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.dataset_folders.made_up import (
    KEYFRAME_EVERY,
    MOVER_M_PER_S,
    cloud,
    write_nuscenes,
    write_once,
    write_small_kitti,
)
from tests.dataset_folders.real_logs import clouds_in, xyz_of
from workers.ingest.plan import plan_recording
from workers.ingest.read import read_shard
from workers.lab.datasets.conversion.convert import ConvertedLog, OutputTakenError, convert
from workers.lab.datasets.published.catalogue import find_layout, open_logs
from workers.lab.datasets.published.options import ReadOptions
from workers.lab.evaluation.truth.truth import LogTruth
from workers.memory import peak_memory_bytes


def converted(
    name: str, source: Path, work: Path, options: ReadOptions | None = None, **more: Any
) -> list[ConvertedLog]:
    layout = find_layout(name)
    logs = open_logs(layout, source, options or ReadOptions())
    return list(convert(layout, logs, to=str(work / "logs"), truth=work / "truth", **more))


def settings_of(url: str) -> MiningSettings:
    return MiningSettings(bucket=url, artifacts="memory://")


def arrays_of(work: Path, log: str, number: int) -> dict[str, NDArray[Any]]:
    with np.load(work / "truth" / log / f"{number:06d}.npz") as arrays:
        return dict(arrays)


def poses_of(work: Path, log: str) -> NDArray[np.float64]:
    with np.load(work / "truth" / log / "poses.npz") as arrays:
        found: NDArray[np.float64] = arrays["world_from_lidar_at_stamp"]
    return found


def test_nuscenes_is_turned_ahead_and_its_boxes_are_interpolated(tmp_path: Path) -> None:
    (log,) = converted("nuscenes", write_nuscenes(tmp_path / "source"), tmp_path)
    assert log.log == "n008/2018-07-24/nuscenes-scene-0001"
    assert any("interpolated" in note for note in log.notes)
    clouds = list(clouds_in(tmp_path / "logs" / f"{log.log}.mcap"))
    expected, kinds = cloud(-5.0)
    assert np.allclose(xyz_of(clouds[0]), expected, atol=1e-5)
    assert clouds[0].stamp_ns == 1_532_402_927_600_000_000
    # the car drives ahead, and the lidar's x axis with it
    poses = poses_of(tmp_path, log.log)
    assert np.allclose(poses[30][:3, 3] - poses[0][:3, 3], (3.0, 0.0, 0.0), atol=1e-6)
    assert np.allclose(poses[0][:3, :3], np.eye(3), atol=1e-6)
    for number in (0, 5, 10, 17):
        truth = arrays_of(tmp_path, log.log, number)
        assert (truth["motion"][kinds == 2] == 2).mean() > 0.95, number
        assert (truth["motion"][kinds == 1] == 1).all(), number
        assert (truth["motion"][kinds == 0] != 2).all(), number
    assert (arrays_of(tmp_path, log.log, 0)["semantic"][kinds == 0] == 24).all()
    assert (arrays_of(tmp_path, log.log, 5)["semantic"][kinds == 1] == 17).all()
    tracks = (tmp_path / "truth" / log.log / "tracks.csv").read_text()
    assert f"{MOVER_M_PER_S}" in tracks


def test_nuscenes_without_interpolation_judges_keyframes_alone(tmp_path: Path) -> None:
    options = ReadOptions(between_keyframes=False)
    (log,) = converted("nuscenes", write_nuscenes(tmp_path / "source"), tmp_path, options)
    judged = sorted(path.stem for path in (tmp_path / "truth" / log.log).glob("0*.npz"))
    assert judged == [f"{n:06d}" for n in range(0, 31, KEYFRAME_EVERY)]
    assert any("not judged" in note for note in log.notes)


def test_once_is_turned_ahead_and_has_classes_without_motion(tmp_path: Path) -> None:
    (log,) = converted("once", write_once(tmp_path / "source"), tmp_path)
    clouds = list(clouds_in(tmp_path / "logs" / f"{log.log}.mcap"))
    expected, kinds = cloud(-5.0)
    assert np.array_equal(xyz_of(clouds[1]).astype(np.float32), expected)
    truth = arrays_of(tmp_path, log.log, 0)
    assert sorted(truth) == ["semantic"]
    assert (truth["semantic"][kinds == 1] == 1).all()
    assert not truth["semantic"][kinds != 1].any()
    assert not (tmp_path / "truth" / log.log / "000001.npz").exists()
    # its y axis looks back: minus one metre of y is a metre ahead
    poses = poses_of(tmp_path, log.log)
    ahead = np.linalg.inv(poses[0]) @ poses[1]
    assert np.allclose(ahead[:3, 3], (1.0, 0.0, 0.0), atol=1e-9)


def test_semantickitti_has_motion_tracks_poses_of_the_lidar_and_labels(tmp_path: Path) -> None:
    source = write_small_kitti(tmp_path / "source")
    (log,) = converted("semantickitti", source, tmp_path, labels=tmp_path / "labels")
    truth, kinds = arrays_of(tmp_path, log.log, 1), cloud(0.0)[1]
    assert (truth["motion"] == np.array([1, 1, 2])[kinds]).all()
    assert (truth["semantic19"] == np.array([9, 1, 1])[kinds]).all()
    assert (truth["ground"] == (kinds == 0)).all()
    assert len(np.unique(truth["track"][kinds > 0])) == 2
    assert np.allclose(poses_of(tmp_path, log.log)[2][:3, 3], (0.4, 0.0, 0.0), atol=1e-9)
    written = (tmp_path / "labels" / log.log / "000001.label").read_bytes()
    original = source / "dataset" / "sequences" / "08" / "labels" / "000001.label"
    assert written == original.read_bytes()


def test_a_converted_log_is_one_that_mining_reads(tmp_path: Path) -> None:
    (log,) = converted("semantickitti", write_small_kitti(tmp_path / "source"), tmp_path)
    bucket = open_bucket(str(tmp_path / "logs"))
    (recording,) = group_recordings(bucket.list())
    assert recording.log_id == log.log
    truth = LogTruth.beside(recording, tmp_path / "truth")
    assert truth is not None
    assert (truth.topic, len(truth)) == ("/velodyne_points", 3)
    about = json.loads((tmp_path / "truth" / log.log / "dataset.json").read_text())
    assert "CC BY-NC-SA" in about["licence"]
    assert "Behley" in about["attribution"]
    plan = plan_recording(bucket, recording, settings_of(bucket.url))
    assert (plan.refused, plan.vehicle, plan.date) == ("", "annieway", "2011-09-30")
    frames = [
        frame
        for shard in plan.shards
        for frame in read_shard(bucket, recording, shard, settings_of(bucket.url)).frames()
    ]
    assert len(frames) == 3


def test_a_second_run_keeps_what_is_there_and_a_foreign_log_is_refused(tmp_path: Path) -> None:
    source = write_small_kitti(tmp_path / "source")
    (log,) = converted("semantickitti", source, tmp_path)
    path = tmp_path / "logs" / f"{log.log}.mcap"
    before = path.stat().st_mtime_ns
    (again,) = converted("semantickitti", source, tmp_path)
    assert (again.outcome, path.stat().st_mtime_ns) == ("there already", before)
    (tmp_path / "truth" / log.log / "dataset.json").unlink()
    with pytest.raises(OutputTakenError, match="--force"):
        converted("semantickitti", source, tmp_path)
    (forced,) = converted("semantickitti", source, tmp_path, force=True)
    assert forced.outcome == "written"


def test_a_damaged_folder_leaves_neither_log_nor_truth(tmp_path: Path) -> None:
    source = write_small_kitti(tmp_path / "source")
    label = source / "dataset" / "sequences" / "08" / "labels" / "000002.label"
    label.write_bytes(label.read_bytes()[:-4])
    with pytest.raises(Exception, match="labels"):
        converted("semantickitti", source, tmp_path)
    assert not list((tmp_path / "logs").rglob("*.mcap"))
    assert not list((tmp_path / "truth").rglob("dataset.json"))


def test_memory_does_not_grow_with_the_frames(tmp_path: Path) -> None:
    source = write_small_kitti(tmp_path / "source", frames=100, points=1000)
    converted("semantickitti", source, tmp_path / "first")
    before = peak_memory_bytes()
    more = write_small_kitti(tmp_path / "more", frames=500, points=1000)
    converted("semantickitti", more, tmp_path / "second")
    assert peak_memory_bytes() - before < 20 << 20
