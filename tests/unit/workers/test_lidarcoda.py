import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import PermanentError
from tests.coda_folder import write_coda
from workers.lab.lidarcoda.annotations import Dataset, read_coda
from workers.lab.lidarcoda.build import build
from workers.lab.lidarcoda.cameras import read_camera
from workers.lab.lidarcoda.clustering import ClusteredBox
from workers.lab.lidarcoda.evaluation import evaluate
from workers.lab.lidarcoda.files import read_box, read_cloud
from workers.lab.lidarcoda.grades import (
    object_labels,
    read_grades,
    read_published_grades,
    write_grades,
)
from workers.lab.lidarcoda.once_camera import distort, undistorted_matrix
from workers.lidar.fidelity import Form


@pytest.fixture
def coda(tmp_path: Path) -> Path:
    write_coda(tmp_path / "coda")
    return tmp_path / "coda"


def _graded(source: Path, out: Path, *, published: bool = False) -> None:
    out.mkdir(exist_ok=True)
    write_grades(out, read_published_grades(source / "annotation_validation"))
    build(source, out, read_coda(source), published=published)


def _files(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_each_box_contains_its_object_by_index_in_every_data_set(
    coda: Path, tmp_path: Path
) -> None:
    found = read_coda(coda)
    assert [image.dataset for image in found.images.values()] == [
        *(Dataset.KITTI, Dataset.ONCE),
        *(Dataset.NUSCENES, Dataset.KITTI),
    ]
    built = build(coda, tmp_path / "out", found)
    assert (built.images, built.annotations, built.clustered, built.ungraded) == (4, 12, 12, 12)
    for annotation in found.annotations:
        box = read_box(tmp_path / "out", annotation.id)
        place = (annotation.id - 1) % 3  # the objects are rows 0, 40 and 80 of each cloud
        mine = set(range(40 * place, 40 * place + 40))
        assert set(box.index[box.dbscan > 0].tolist()) <= mine
        assert len(mine & set(box.index[box.dbscan > 0].tolist())) > 20
        cloud = read_cloud(coda, found.images[annotation.image_id])
        assert np.abs(cloud[box.index] - box.columns[:, :3]).max() < 0.001


def test_a_killed_build_goes_on_and_gives_the_same_bytes(coda: Path, tmp_path: Path) -> None:
    _graded(coda, tmp_path / "whole")
    out = tmp_path / "killed"
    out.mkdir()
    write_grades(out, read_published_grades(coda / "annotation_validation"))
    script = (
        "import sys, time; from pathlib import Path\n"
        "from workers.lab.lidarcoda.annotations import read_coda\n"
        "from workers.lab.lidarcoda.build import build\n"
        "source, out = map(Path, sys.argv[1:])\n"
        "build(source, out, read_coda(source), on_progress=lambda done: time.sleep(60))\n"
    )
    command = [sys.executable, "-c", script, str(coda), str(out)]
    with subprocess.Popen(command, cwd=Path(__file__).parents[3]) as process:
        deadline = time.monotonic() + 120
        while not (out / "lidar_labels" / "0003.bin").exists():
            assert time.monotonic() < deadline
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGKILL)
    assert not (out / "lidar_labels" / "0010.bin").exists()
    resumed = build(coda, out, read_coda(coda))
    assert 0 < resumed.clustered < 12
    assert _files(out) == _files(tmp_path / "whole")


def test_labels_of_each_grade() -> None:
    columns = np.zeros((4, 7), np.float32)
    columns[:, 4], columns[:, 6] = (1, 1, -1, -1), (1, -1, 1, -1)
    box = ClusteredBox(np.arange(4, dtype=np.int32), columns)
    dbscan, shift = [1, 1, -1, -1], [1, -1, 1, -1]
    expected = {
        **{1: dbscan, 2: shift, 3: dbscan, 4: [1, 1, 1, -1], 5: [-1, -1, 1, 1]},
        **{6: [1] * 4, 7: [1] * 4, 8: [-1, 1, -1, 1], 9: [1] * 4, 33: [1] * 4},
    }
    assert {grade: object_labels(box, grade).tolist() for grade in expected} == expected


def test_the_published_form_begins_with_its_row_and_keeps_points_of_two_boxes(
    coda: Path, tmp_path: Path
) -> None:
    _graded(coda, tmp_path / "published", published=True)
    _graded(coda, tmp_path / "corrected")
    name = Path("lidar_labels") / "0003.bin"
    published, corrected = (
        np.fromfile(tmp_path / form / name, "<f4").reshape(-1, 4)
        for form in ("published", "corrected")
    )
    assert (published == -1).all(axis=1).any()
    assert not (corrected == -1).all(axis=1).any()
    with pytest.raises(PermanentError, match="another form"):
        build(coda, tmp_path / "published", read_coda(coda))


def _method(coda: Path, out: Path, folder: Path) -> None:
    """Contradict on objects of odd annotations, agree elsewhere; a wall point is a false alarm."""
    folder.mkdir()
    found = read_coda(coda)
    for image in found.images.values():
        rows = np.fromfile(out / "original_labels" / f"{image.stem}.bin", "<f4").reshape(-1, 4)
        category = np.where(rows[:, 3] > 0, 3, 1).astype(np.float32)
        category[::2] = np.where(category[::2] == 3, 1, category[::2])
        far = np.array([[99.0, 0.0, 0.0, 4.0]], np.float32)
        points = np.vstack((np.column_stack((rows[:, :3], category)), far))
        (folder / f"{image.stem}.bin").write_bytes(points.astype("<f4").tobytes())


@pytest.mark.parametrize("form", [Form.CORRECTED, Form.PAPER])
def test_both_tables_are_those_computed_by_hand(coda: Path, tmp_path: Path, form: Form) -> None:
    out, output = tmp_path / "out", tmp_path / "output"
    _graded(coda, out)
    _method(coda, out, output)
    found = evaluate(out, output, read_coda(coda), form=form)
    ious, precisions, recalls = [], [], []
    for image in read_coda(coda).images.values():
        rows = np.fromfile(out / "original_labels" / f"{image.stem}.bin", "<f4").reshape(-1, 4)
        on = rows[:, 3] > 0
        taken = np.arange(len(rows)) % 2 == 1
        tp, fn, fp = int((on & taken).sum()), int((on & ~taken).sum()), 1
        ious.append(tp / (tp + fp + fn))
        precisions.append(tp / (tp + fp))
        recalls.append(tp / (tp + fn))
    coda_row = found.frames[0]
    assert (coda_row.name, coda_row.measures.n) == ("CODA", 4)
    assert coda_row.measures.mean_iou == pytest.approx(np.mean(ious))
    assert coda_row.measures.average_precision == pytest.approx(np.mean(precisions))
    assert coda_row.measures.average_recall == pytest.approx(np.mean(recalls))
    p, r = np.mean(precisions), np.mean(recalls)
    assert coda_row.measures.f1 == pytest.approx(2 * p * r / (p + r))
    assert [row.name for row in found.frames] == ["CODA", "once", "kitti", "nuscenes"]
    assert [(row.name, row.measures.n) for row in found.annotations] == [
        *(("pedestrian", 4), ("vehicle", 4)),
        ("animal", 4),
    ]
    assert coda_row.outcomes[3] == 4  # one false alarm per frame


def test_the_published_folder_of_a_method_is_read_by_name(coda: Path, tmp_path: Path) -> None:
    out, output = tmp_path / "out", tmp_path / "output"
    _graded(coda, out)
    _method(coda, out, output)
    published = tmp_path / "published"
    for image in read_coda(coda).images.values():
        rows = np.fromfile(output / f"{image.stem}.bin", "<f4").reshape(-1, 4)
        name = Path(image.file_name).stem
        base = published / "anomalies_sup_self" / name
        for folder, values in (
            ("pc_velo_camerafov", rows[:, :3].astype("<f4")),
            ("anomaly_labels", rows[:, 3].astype("<i2")),
        ):
            (base / folder).mkdir(parents=True)
            (base / folder / f"{name}_8.bin").write_bytes(values.tobytes())
    ours, theirs = (evaluate(out, each, read_coda(coda)) for each in (output, published))
    assert np.array_equal(ours.frame_counts, theirs.frame_counts)
    assert np.array_equal(ours.annotation_counts, theirs.annotation_counts)


def test_the_lens_of_once_bends_points_towards_the_centre() -> None:
    intrinsic = np.array([[1000.0, 0, 960], [0, 1000.0, 510], [0, 0, 1]])
    lens = np.array([-0.1, 0.02, 0.0, 0.0, 0.0])
    assert distort(np.array([[0.5, 0.0]]), lens)[0, 0] < 0.5
    flat = undistorted_matrix(intrinsic, np.zeros(5))
    assert np.allclose(flat, intrinsic, atol=1.0)
    assert undistorted_matrix(intrinsic, lens)[0, 0] < 1000


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "lidar" / "0004.bin").unlink(), "image 4 .* no lidar frame"),
        (lambda folder: (folder / "lidar" / "0004.bin").write_bytes(b"abc"), "3 bytes are no rows"),
        (lambda folder: (folder / "calib" / "0003.txt").write_text("P2: 1 2"), "R0_rect"),
        (lambda folder: (folder / "calib" / "0007.json").write_text("{}"), "nuscenes"),
        (lambda folder: (folder / "corner_case.json").write_text("[]"), "no annotations of CODA"),
        (lambda folder: (folder / "corner_case.json").unlink(), "cannot read CODA"),
    ],
)
def test_a_damaged_folder_is_refused_with_a_sentence(
    coda: Path, tmp_path: Path, damage: object, message: str
) -> None:
    assert callable(damage)
    damage(coda)
    with pytest.raises(PermanentError, match=message):
        build(coda, tmp_path / "out", read_coda(coda))


def test_grade_33_is_refused_by_line_and_accepted_in_the_published_form(tmp_path: Path) -> None:
    path = tmp_path / "annotation_validation"
    path.write_text("1\n33\n2\n")
    with pytest.raises(PermanentError, match=r"'33' is no grade from 1 to 9 .*line 2"):
        read_published_grades(path)
    assert read_published_grades(path, published=True) == {1: 1, 2: 33, 3: 2}


def test_damaged_grades_are_refused(tmp_path: Path) -> None:
    (tmp_path / "grades.json").write_text("[1")
    with pytest.raises(PermanentError, match="cannot read the grades"):
        read_grades(tmp_path)


def test_points_behind_the_camera_are_left_out(coda: Path) -> None:
    for image in read_coda(coda).images.values():
        cloud = read_cloud(coda, image)
        behind = -cloud
        assert len(read_camera(coda, image)(behind).index) == 0
