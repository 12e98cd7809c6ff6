"""Formats with points: their layouts, their pre-labels, and the way back to the raw message."""

import json
from pathlib import Path

import numpy as np
import pytest

from service.export.classes import semantickitti_ids
from tests.export_world import (
    FRAMES,
    MOVER,
    POINTS,
    WALKER,
    ExportWorld,
    files_of,
    made_world,
    record,
    returns,
    rows,
)
from tests.needed import needed
from tests.readers.environment import read_by

CAR, MOVING_CAR, BUILDING, MOVING_PERSON = 10, 252, 50, 254


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> ExportWorld:
    return made_world(tmp_path_factory.mktemp("formats"))


def exported(world: ExportWorld, form: str, folder: Path, *, scenes: int = 1) -> Path:
    report = world.export(world.selection(scenes=scenes), form, folder)
    assert report.missing == {}
    return folder / next(iter(report.written.values())).place


def test_semantickitti_has_the_published_layout(world: ExportWorld, tmp_path: Path) -> None:
    exported(world, "semantickitti", tmp_path, scenes=2)
    names = [f"{number:06d}" for number in range(FRAMES)]
    of_a_sequence = [
        *("calib.txt", "frames.json"),
        *(f"index/{name}.bin" for name in names),
        *(f"labels/{name}.label" for name in names),
        "poses.txt",
        "times.txt",
        *(f"velodyne/{name}.bin" for name in names),
    ]
    assert files_of(tmp_path) == sorted(
        [
            "counterpoint-export.jsonl",
            "labels.yaml",
            *(f"sequences/{number}/{file}" for number in ("00", "01") for file in of_a_sequence),
        ]
    )


def test_pre_labels_name_moving_things_and_the_track_of_a_contradiction(
    world: ExportWorld, tmp_path: Path
) -> None:
    folder = exported(world, "semantickitti", tmp_path)
    words = np.fromfile(folder / "labels/000001.label", dtype="<u4")
    index = np.fromfile(folder / "index/000001.bin", dtype="<u4")
    labels, instances = words & 0xFFFF, words >> 16
    expected = np.full(POINTS, BUILDING)
    expected[MOVER], expected[WALKER] = MOVING_CAR, MOVING_PERSON
    np.testing.assert_array_equal(labels, expected[index])
    np.testing.assert_array_equal(instances, np.isin(index, MOVER))


def test_each_raw_point_comes_back_by_its_index_or_has_no_return(
    world: ExportWorld, tmp_path: Path
) -> None:
    folder = exported(world, "semantickitti", tmp_path)
    for number, frame in enumerate(json.loads((folder / "frames.json").read_text())["frames"]):
        index = np.fromfile(folder / f"index/{number:06d}.bin", dtype="<u4")
        cloud = np.fromfile(folder / f"velodyne/{number:06d}.bin", dtype="<f4").reshape(-1, 4)
        assert (frame["raw_points"], frame["points"]) == (POINTS, len(cloud))
        np.testing.assert_array_equal(index, returns())
        np.testing.assert_array_equal(cloud, rows(20 + number)[index])


def test_kiss_icp_reads_the_sequence_and_its_calibration(
    world: ExportWorld, tmp_path: Path
) -> None:
    from kiss_icp.datasets.kitti import KITTIOdometryDataset

    exported(world, "semantickitti", tmp_path)
    (tmp_path / "poses").mkdir()
    poses = (tmp_path / "sequences/00/poses.txt").read_bytes()
    (tmp_path / "poses/00.txt").write_bytes(poses)
    read = KITTIOdometryDataset(tmp_path, "00")
    assert len(read) == FRAMES
    assert read[1][0].shape == (len(returns()), 3)
    np.testing.assert_allclose(read.gt_poses[:, 0, 3], 0.5 * np.arange(FRAMES), atol=1e-6)
    np.testing.assert_allclose(read.gt_poses[:, 1:3, 3], 0.0, atol=1e-6)
    np.testing.assert_allclose(read.get_frames_timestamps()[:, 0], 0.1 * np.arange(FRAMES))


def test_an_independent_reader_reads_the_pcd(world: ExportWorld, tmp_path: Path) -> None:
    pypcd4 = needed("pypcd4", "the extra `dev`")
    folder = exported(world, "cvat", tmp_path / "cvat")
    read = pypcd4.PointCloud.from_path(folder / "pointcloud/000002.pcd")
    assert read.fields == ("x", "y", "z", "intensity", "label", "index")
    assert read.points == len(returns())
    points = read.numpy(("x", "y", "z", "intensity", "label", "index"))
    np.testing.assert_allclose(points[:, :4], rows(22)[returns()])
    np.testing.assert_array_equal(points[:, 5], returns())
    other = exported(world, "xtreme1", tmp_path / "xtreme1")
    same = (other / "lidar_point_cloud_0/000002.pcd").read_bytes()
    assert same == (folder / "pointcloud/000002.pcd").read_bytes()


def test_segments_reads_sample_and_labels(world: ExportWorld, tmp_path: Path) -> None:
    read = read_by("read_segments", exported(world, "segments", tmp_path))
    assert read["types"] == ["binary-xyzi"] * FRAMES
    assert read["ahead_m"][2] == pytest.approx(1.0)
    of_point = read["categories"]
    assert len(of_point) == len(returns())
    assert [of_point[i] for i in np.flatnonzero(np.isin(returns(), MOVER))] == [MOVING_CAR] * 7


def test_the_nuscenes_devkit_opens_a_scene(world: ExportWorld, tmp_path: Path) -> None:
    read = read_by("read_nuscenes", exported(world, "nuscenes-lidarseg", tmp_path))
    names = read["names"]
    np.testing.assert_allclose(read["points"], rows(21)[returns(), :3])
    assert len(names) == len(read["points"])
    assert names.count("human.pedestrian.adult") == len(set(WALKER) & set(returns().tolist()))
    assert read["samples"] == FRAMES
    assert read["log"] == record().log_id


def test_classes_of_other_data_sets_are_found_by_their_names() -> None:
    still, moving = semantickitti_ids(("Vehicle.Car", "bus", "two_wheeler", "dragon"))
    assert still.tolist() == [CAR, 13, 11, 0, 0]
    assert moving.tolist() == [MOVING_CAR, 257, 253, 259, 259]
