"""Damaged and foreign folders of data sets: one sentence each, and exit 1."""

import gzip
import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.cli.main import main
from tests.dataset_folders.argoverse2 import pose_columns, write_feather
from tests.dataset_folders.made_up import write_nuscenes, write_once, write_small_kitti
from tests.dataset_folders.old_pickles import write_frame
from workers.lab.datasets.published.frame_pickles import PickleRefusedError, read_frame

KITTI = Path("dataset/sequences/08")


def refused(capsys: pytest.CaptureFixture[str], dataset: str, source: Path, work: Path) -> str:
    code = main(
        ["convert", dataset, str(source), "--to", str(work / "l"), "--truth", str(work / "t")]
    )
    said = capsys.readouterr().err
    assert code == 1, said
    assert "Traceback" not in said
    lines = [line for line in said.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1, said
    assert not list((work / "l").rglob("*.mcap"))
    return lines[0]


def without(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def cut(name: str, count: int = 4) -> Callable[[Path], None]:
    def shorten(folder: Path) -> None:
        path = folder / name
        path.write_bytes(path.read_bytes()[:-count])

    return shorten


def strange_class(folder: Path) -> None:
    path = folder / "labels" / "000001.label"
    labels = np.frombuffer(path.read_bytes(), "<u4").copy()
    labels[7] = 77
    path.write_bytes(labels.tobytes())


def image_alone(folder: Path) -> None:
    (folder / "image_2" / "000009.png").write_bytes(
        (folder / "image_2" / "000001.png").read_bytes()
    )


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (without("velodyne/000001.bin"), "frame 1 is missing"),
        (without("labels/000002.label"), "scan 2 has no labels"),
        (cut("labels/000001.label"), "labels and scans are not of one release"),
        (cut("velodyne/000001.bin", 3), "the file is cut"),
        (strange_class, "the class 77, which is none of SemanticKITTI's"),
        (image_alone, "image 9 has no lidar frame"),
        (cut("poses.txt", 30), "is no pose of 12 finite numbers"),
        (without("times.txt"), "times.txt"),
    ],
)
def test_damaged_kitti(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    damage: Callable[[Path], None],
    said: str,
) -> None:
    source = write_small_kitti(tmp_path / "source")
    damage(source / KITTI)
    assert said in refused(capsys, "semantickitti", source, tmp_path)


def test_an_empty_folder_and_none(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert "the folder is empty" in refused(capsys, "once", tmp_path / "empty", tmp_path)
    assert "no such folder" in refused(capsys, "once", tmp_path / "none", tmp_path)


@pytest.mark.parametrize(
    ("write", "asked", "looks_like"),
    [
        (write_small_kitti, "pandaset", "SemanticKITTI"),
        (write_nuscenes, "kitti360", "nuScenes"),
        (write_once, "argoverse2", "ONCE"),
    ],
)
def test_another_layout_is_named(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    write: Callable[[Path], Path],
    asked: str,
    looks_like: str,
) -> None:
    said = refused(capsys, asked, write(tmp_path / "source"), tmp_path)
    assert f"this looks like {looks_like}" in said


def argoverse2(root: Path, category: str = "REGULAR_VEHICLE") -> Path:
    log = root / "val" / "log"
    (log / "sensors" / "lidar").mkdir(parents=True)
    columns: dict[str, Any] = {name: np.ones(50, np.float16) for name in "xyz"}
    columns |= {name: np.ones(50, np.uint8) for name in ("intensity", "laser_number")}
    columns["offset_ns"] = np.arange(50, dtype=np.int32)
    write_feather(log / "sensors" / "lidar" / "315966265259836000.feather", columns)
    pose = pose_columns([np.eye(4)])
    stamp = {"timestamp_ns": np.array([315966265259836000])}
    write_feather(log / "city_SE3_egovehicle.feather", {**stamp, **pose})
    boxes = {f"{side}_m": np.array([2.0]) for side in ("length", "width", "height")}
    names = {"track_uuid": np.array(["a"]), "category": np.array([category])}
    write_feather(log / "annotations.feather", {**stamp, **names, **boxes, **pose})
    return root


@pytest.mark.parametrize(
    "name", ["sensors/lidar/315966265259836000.feather", "annotations.feather"]
)
def test_a_cut_feather_file(capsys: pytest.CaptureFixture[str], tmp_path: Path, name: str) -> None:
    source = argoverse2(tmp_path / "source")
    cut(name, 40)(source / "val" / "log")
    said = refused(capsys, "argoverse2", source, tmp_path)
    assert "the feather file is cut or damaged" in said
    assert Path(name).name in said


def test_an_unknown_category(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    source = argoverse2(tmp_path / "source", "SPACESHIP")
    assert "the class SPACESHIP" in refused(capsys, "argoverse2", source, tmp_path)


class _Code:
    """Object whose pickle calls a function."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (self.mark,))


def pandaset(root: Path) -> Path:
    folder = root / "001"
    pose = {"position": dict.fromkeys("xyz", 0.0), "heading": {"w": 1.0, **dict.fromkeys("xyz", 0)}}
    sweep = {name: np.ones(9) for name in ("x", "y", "z", "i", "t")}
    write_frame(folder / "lidar" / "00.pkl.gz", {**sweep, "d": np.zeros(9, np.int64)})
    (folder / "lidar" / "poses.json").write_text(json.dumps([pose]))
    (folder / "lidar" / "timestamps.json").write_text("[1557539924.5]")
    write_frame(
        folder / "annotations" / "semseg" / "00.pkl.gz", {"class": np.full(9, 13, np.int64)}
    )
    return root


def test_a_pickle_with_code_is_refused_and_runs_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    source, mark = pandaset(tmp_path / "source"), tmp_path / "ran"
    code = gzip.compress(pickle.dumps(_Code(mark)))
    (source / "001" / "lidar" / "00.pkl.gz").write_bytes(code)
    said = refused(capsys, "pandaset", source, tmp_path)
    assert "nothing of the file was run" in said
    assert not mark.exists()


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (cut("lidar/00.pkl.gz", 20), "the file is cut or damaged"),
        (
            lambda folder: write_frame(
                folder / "annotations/semseg/00.pkl.gz", {"class": np.full(8, 13, np.int64)}
            ),
            "labels and sweeps are not of one release",
        ),
        (
            lambda folder: write_frame(
                folder / "annotations/semseg/00.pkl.gz", {"class": np.full(9, 99, np.int64)}
            ),
            "the class 99, which is none of PandaSet's",
        ),
        (lambda folder: (folder / "lidar/poses.json").write_text("[]"), "0 poses"),
        (lambda folder: (folder / "lidar/poses.json").write_text("[{"), "damaged JSON"),
    ],
)
def test_damaged_pandaset(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    damage: Callable[[Path], Any],
    said: str,
) -> None:
    source = pandaset(tmp_path / "source")
    damage(source / "001")
    assert said in refused(capsys, "pandaset", source, tmp_path)


@pytest.mark.parametrize("name", ["builtins.eval", "os.system", "pandas.core.frame.eval"])
def test_names_outside_of_tables_are_refused(tmp_path: Path, name: str) -> None:
    module, _, function = name.rpartition(".")
    path = tmp_path / "00.pkl"
    path.write_bytes(f"c{module}\n{function}\n(S'1'\ntR.".encode())
    with pytest.raises(PickleRefusedError, match=name):
        read_frame(path)


def test_columns_of_a_frame_come_back(tmp_path: Path) -> None:
    path = tmp_path / "00.pkl.gz"
    columns = {
        "x": np.arange(4.0),
        "d": np.array([0, 1, 1, 0]),
        "label": np.array(["Car", "Bus", None, "Car"], object),
    }
    write_frame(path, columns, index=np.array([3, 5, 7, 9]))
    found = read_frame(path)
    assert found["index"].tolist() == [3, 5, 7, 9]
    for name, values in columns.items():
        assert found[name].tolist() == values.tolist()


def test_a_cut_table_and_a_missing_sweep_of_nuscenes(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    source = write_nuscenes(tmp_path / "source", sweeps=11)
    table = source / "v1.0-mini" / "sample_annotation.json"
    whole = table.read_text()
    table.write_text(whole[: len(whole) // 2])
    assert "the table is cut" in refused(capsys, "nuscenes", source, tmp_path)
    table.write_text(whole)
    next((source / "sweeps" / "LIDAR_TOP").iterdir()).unlink()
    assert "cannot read" in refused(capsys, "nuscenes", source, tmp_path)


def test_a_frame_and_an_image_of_once(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    source = write_once(tmp_path / "source")
    folder = source / "data" / "000027"
    extra = folder / "cam01" / "1.jpg"
    extra.write_bytes(next((folder / "cam01").iterdir()).read_bytes())
    assert "image without a lidar frame" in refused(capsys, "once", source, tmp_path)
    extra.unlink()
    next((folder / "lidar_roof").iterdir()).unlink()
    assert "is missing in" in refused(capsys, "once", source, tmp_path)
