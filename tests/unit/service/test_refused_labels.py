"""Files that do not fit an export: one sentence, exit code 1, and no truth is written."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.cli.main import main
from tests.export_world import ExportWorld, made_world
from tests.returned_labels import LABELLERS
from tests.unit.service.exported_state import state_of_the_world

Exported = Callable[[str], Path]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> tuple[ExportWorld, Path]:
    folder = tmp_path_factory.mktemp("refused")
    return made_world(folder), state_of_the_world(folder / "state")


@pytest.fixture
def exported(world: tuple[ExportWorld, Path], tmp_path: Path) -> Exported:
    """Export the selection in the format of a form, labelled by its rule."""

    def export(form: str) -> Path:
        name, label = LABELLERS.get(form, (form, None))
        report = world[0].export(world[0].selection(), name, tmp_path / "out")
        for written in report.written.values():
            if label is not None:
                label(tmp_path / "out" / written.place, np.random.default_rng(3))
        return tmp_path / "out"

    return export


def refused(
    world: tuple[ExportWorld, Path],
    out: Path,
    form: str,
    capsys: pytest.CaptureFixture[str],
) -> str:
    """Import, and return the sentence that refuses it."""
    truth = out.parent / "truth"
    state = str(world[1])
    capsys.readouterr()
    arguments = ["--format", form, "--truth", str(truth), "--state", state]
    assert main(["import-labels", str(out), *arguments]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1, told
    assert not truth.exists()
    return told


def first(out: Path, pattern: str) -> Path:
    return sorted(out.rglob(pattern))[0]


def longer(pattern: str, more: bytes) -> Callable[[Path], object]:
    def spoil(out: Path) -> None:
        path = first(out, pattern)
        path.write_bytes(path.read_bytes() + more)

    return spoil


def gone(pattern: str) -> Callable[[Path], object]:
    return lambda out: first(out, pattern).unlink()


def edited(pattern: str, change: Callable[[Any], object]) -> Callable[[Path], object]:
    def spoil(out: Path) -> None:
        path = first(out, pattern)
        read = json.loads(path.read_text())
        change(read)
        path.write_text(json.dumps(read))

    return spoil


def exchanged(pattern: str) -> Callable[[Path], object]:
    """Put the file of the second scene in the place of that of the first one."""

    def spoil(out: Path) -> None:
        one, two = [path for path in sorted(out.rglob(pattern)) if "counterpoint" not in path.name]
        shutil.copy(two, one)

    return spoil


def another_class(label: int) -> Callable[[Path], object]:
    def spoil(out: Path) -> None:
        path = first(out, "*.label")
        words = np.fromfile(path, dtype="<u4")
        words[5] = label
        words.tofile(path)

    return spoil


def a_point_more_in_the_cloud(out: Path) -> None:
    path = first(out, "000000.pcd")
    data = path.read_bytes()
    data = data.replace(b"WIDTH 34", b"WIDTH 35").replace(b"POINTS 34", b"POINTS 35")
    path.write_bytes(data + data[-24:])


def the_cloud_of_the_next_frame(out: Path) -> None:
    """Exchange the index of a cloud; the frames of this world have equal ones."""
    path = first(out, "000000.pcd")
    data = bytearray(path.read_bytes())
    data[-4:] = (0).to_bytes(4, "little")
    path.write_bytes(data)


def no_labels(out: Path) -> None:
    for path in out.rglob("*.label"):
        path.unlink()


def move_nuscenes_stamps(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        row["timestamp"] += 5


def cuboid_of(document: dict[str, Any]) -> Any:
    objects = document["openlabel"]["frames"]["0"]["objects"]
    return next(iter(objects.values()))["object_data"]["cuboid"][0]


CASES: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "semantickitti, a label more": (
        *("semantickitti", longer("000000.label", bytes(4))),
        "frame 0 has 35 labels for 34 points",
    ),
    "semantickitti, unknown class": (
        *("semantickitti", another_class(7)),
        "labels of class 7, which SemanticKITTI does not have",
    ),
    "semantickitti, no index": (
        *("semantickitti", gone("index/000000.bin")),
        "cannot read the index: No such file or directory",
    ),
    "semantickitti, frames of another scene": (
        *("semantickitti", exchanged("frames.json")),
        "this list of frames is of another scene",
    ),
    "semantickitti, no labels at all": (
        "semantickitti",
        no_labels,
        "no frame of this export has labels of format semantickitti",
    ),
    "segments, a point more": (
        "segments",
        edited("label.json", lambda label: label["frames"][0]["point_annotations"].append(0)),
        "frame 0 has 35 labels for 34 points",
    ),
    "segments, unknown class": (
        "segments",
        edited(
            "label.json",
            lambda label: label["frames"][1]["annotations"][0].update(category_id=8),
        ),
        "labels of class 8",
    ),
    "segments, another scene": (
        *("segments", exchanged("label.json")),
        "this label of Segments.ai is of another scene: frame 0 has the timestamp",
    ),
    "nuscenes, a label more": (
        *("nuscenes-lidarseg", longer("*_lidarseg.bin", b"\x00")),
        "35 labels for 34 points",
    ),
    "nuscenes, unknown class": (
        *("nuscenes-lidarseg", lambda out: first(out, "*_lidarseg.bin").write_bytes(b"\x63" * 34)),
        "is 'none of the table category', and no class of nuScenes-lidarseg",
    ),
    "nuscenes, missing file": (
        *("nuscenes-lidarseg", gone("*_lidarseg.bin")),
        "cannot read labels: No such file or directory",
    ),
    "nuscenes, another scene": (
        *("nuscenes-lidarseg", edited("sample_data.json", move_nuscenes_stamps)),
        "this table of nuScenes is of another scene: 0 label files for frame 0",
    ),
    "pcd, a point more": (
        *("pcd", a_point_more_in_the_cloud),
        "frame 0 has 35 labels for 34 points",
    ),
    "pcd, bytes more": (*("pcd", longer("000000.pcd", b"x")), "817 bytes for 34 points"),
    "pcd, missing file": (
        *("pcd", gone("000002.pcd")),
        "cannot read labels: No such file or directory",
    ),
    "pcd, other points": (
        *("pcd", the_cloud_of_the_next_frame),
        "this point cloud is of another scene: its index is not that of frame 0",
    ),
    "cvat, unknown class": (
        "cvat",
        edited(
            "default.json",
            lambda read: read["items"][0]["annotations"][0].update(label_id=9),
        ),
        "this is no annotation of Datumaro: ValueError: unknown class 9",
    ),
    "cvat, another selection": (
        *("cvat", edited("default.json", lambda read: read["items"][0].update(id="000077"))),
        "this annotation of Datumaro is of another scene: it has an item '000077'",
    ),
    "cvat, missing cloud": (*("cvat", gone("000001.pcd")), "No such file or directory"),
    "xtreme1, unknown class": (
        "xtreme1",
        edited("000000.json", lambda read: read[0]["objects"][0].update(className="dragon")),
        "this is no result of Xtreme1: ValueError: unknown class 'dragon'",
    ),
    "xtreme1, another selection": (
        "xtreme1",
        lambda out: shutil.copy(first(out, "000003.json"), first(out, "result") / "000009.json"),
        "this result of Xtreme1 is of another scene: the export has no such frame",
    ),
    "xtreme1, no number": (
        "xtreme1",
        edited(
            "000000.json",
            lambda read: read[0]["objects"][0]["contour"]["size3D"].update(x=float("nan")),
        ),
        "this is no result of Xtreme1: ValueError: a cuboid with edges of [nan",
    ),
    "fiftyone, another selection": (
        "fiftyone",
        edited(
            "samples.json",
            lambda read: [each.update(scene_id="other") for each in read["samples"]],
        ),
        "this list of samples of FiftyOne is of another scene: it has no sample of",
    ),
    "fiftyone, unknown class": (
        "fiftyone",
        edited(
            "samples.json",
            lambda read: read["samples"][0]["contradictions"]["detections"][0].update(label="elf"),
        ),
        "unknown class 'elf'",
    ),
    "openlabel, unknown class": (
        "openlabel",
        edited(
            "*.openlabel.json",
            lambda read: read["openlabel"]["objects"]["0"].update(type="dragon"),
        ),
        "this is no document of OpenLABEL: frame 0: ValueError: unknown class 'dragon'",
    ),
    "openlabel, another selection": (
        *("openlabel", exchanged("*.openlabel.json")),
        "this document of OpenLABEL is of another scene: frame 0 has the stamp",
    ),
    "openlabel, another space": (
        *(
            "openlabel",
            edited("*.openlabel.json", lambda r: cuboid_of(r).update(coordinate_system="odom")),
        ),
        "a cuboid in the space 'odom': labels need 'lidar'",
    ),
    "openlabel, too few numbers": (
        *("openlabel", edited("*.openlabel.json", lambda r: cuboid_of(r).update(val=[1, 2, 3]))),
        "this is no document of OpenLABEL: frame 0: ValueError",
    ),
    "openlabel, missing file": (
        *("openlabel", gone("*.openlabel.json")),
        "cannot read labels: No such file or directory",
    ),
    "openlabel, no JSON": (
        *("openlabel", lambda out: first(out, "*.openlabel.json").write_text("{")),
        "this is no document of OpenLABEL: JSONDecodeError",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_files_that_do_not_fit_are_refused_in_one_sentence(
    world: tuple[ExportWorld, Path],
    exported: Exported,
    capsys: pytest.CaptureFixture[str],
    case: str,
) -> None:
    form, spoil, said = CASES[case]
    out = exported(form)
    spoil(out)
    assert said in refused(world, out, form, capsys)


def test_an_export_in_another_format_is_refused(
    world: tuple[ExportWorld, Path], exported: Exported, capsys: pytest.CaptureFixture[str]
) -> None:
    told = refused(world, exported("segments"), "pcd", capsys)
    assert "this folder is an export as segments, not as cvat or xtreme1" in told


def test_cuboids_of_a_scene_that_is_not_in_the_state_are_refused(
    world: tuple[ExportWorld, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    selection = world[0].selection(scenes=3)
    world[0].export(selection, "openlabel", tmp_path / "out")
    told = refused(world, tmp_path / "out", "openlabel", capsys)
    assert "cannot find the points of the cuboids: no current scene" in told
