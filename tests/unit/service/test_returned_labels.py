"""Every exported point leads back to its raw point, and every finished label to that point."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.overlay import Overlay
from schemas.score import SceneScore
from service.errors import UsageError
from service.export.formats import FORMATS
from service.export.label_import import ImportedScene, read_scenes
from service.export.labels.forms import LABEL_FORMS, form_named
from tests.export_world import FRAMES, LOG_ID, ExportWorld, made_world, overlay, record, returns
from tests.exported_points import READERS, points_of, raw_clouds
from tests.needed import needed
from tests.returned_labels import LABELLERS, Labelled, label_openlabel
from tests.tiny_logs import LIDAR

SCENES = 2
ROUNDED_M = {"mcap": 0.002}
"""Excerpts round coordinates to 4 mm; their raw message has the exact place."""


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> ExportWorld:
    return made_world(tmp_path_factory.mktemp("returned"))


def current(scene_id: str) -> tuple[SceneScore, Overlay]:
    (score,) = [each for each in map(record, range(SCENES)) if each.scene_id == scene_id]
    return score, overlay(score)


def places_of(world: ExportWorld, form: str, out: Path) -> list[Path]:
    """Export, and return the place of each scene."""
    report = world.export(world.selection(scenes=SCENES), form, out)
    assert report.missing == {}
    return [out / each.place for each in report.written.values()]


def imported(out: Path, form: str) -> list[ImportedScene]:
    return list(read_scenes(out, form_named(form), current))


def test_every_format_that_has_points_is_checked() -> None:
    assert {*READERS} == {name for name, each in FORMATS.items() if each.reads_logs}


@pytest.mark.parametrize("form", READERS)
def test_each_written_point_is_the_raw_point_of_its_index(
    world: ExportWorld, tmp_path: Path, form: str
) -> None:
    needed("pypcd4", "the extra `dev`")
    needed("rerun", "the extra `rerun`")
    raw = raw_clouds(world.bucket / f"{LOG_ID}.mcap", LIDAR)
    for number, place in enumerate(places_of(world, form, tmp_path / "out")):
        frames = list(points_of(form, place))
        stamps = overlay(record(number)).stamps_ns.tolist()
        assert len(frames) == len(stamps) == FRAMES
        for stamp_ns, (index, points) in zip(stamps, frames, strict=True):
            recorded = raw[stamp_ns]
            np.testing.assert_array_equal(index, returns())
            np.testing.assert_array_equal(index, np.flatnonzero(np.isfinite(recorded[:, 0])))
            np.testing.assert_allclose(
                points, recorded[index], rtol=0, atol=ROUNDED_M.get(form, 0) + 1e-12
            )


def test_every_form_of_labels_is_checked() -> None:
    assert {*LABELLERS, "openlabel"} == {*LABEL_FORMS}


@pytest.mark.parametrize("form", LABELLERS)
def test_labels_that_a_rule_changes_return_to_their_raw_points(
    world: ExportWorld, tmp_path: Path, form: str
) -> None:
    needed("pypcd4", "the extra `dev`")
    export, label = LABELLERS[form]
    places = places_of(world, export, tmp_path / "out")
    labelled = [
        label(place, np.random.default_rng(7 + number)) for number, place in enumerate(places)
    ]
    scenes = imported(tmp_path / "out", form)
    assert len(scenes) == SCENES
    for scene, expected in zip(scenes, labelled, strict=True):
        need_same(scene, expected, [returns()] * FRAMES)


def test_cuboids_of_openlabel_label_the_points_of_the_overlay(
    world: ExportWorld, tmp_path: Path
) -> None:
    places = places_of(world, "openlabel", tmp_path / "out")
    labelled = []
    for number, place in enumerate(places):
        shown = overlay(record(number))
        points = [shown.points_cm[shown.points_of(f)][returns()] / 100.0 for f in range(FRAMES)]
        labelled.append(label_openlabel(place, np.random.default_rng(7 + number), points))
    for scene, expected in zip(imported(tmp_path / "out", "openlabel"), labelled, strict=True):
        assert scene.log_id == LOG_ID
        need_same(scene, expected, [returns()] * FRAMES)


@pytest.mark.parametrize("form", ["nuscenes-lidarseg", "pcd", "fiftyone", "openlabel"])
def test_a_frame_that_nobody_labelled_is_noticed(
    world: ExportWorld, tmp_path: Path, form: str
) -> None:
    export = LABELLERS[form][0] if form in LABELLERS else form
    places_of(world, export, tmp_path / "out")
    scenes = imported(tmp_path / "out", form)
    assert all(frame.is_unchanged for scene in scenes for frame in scene.frames)


@pytest.mark.parametrize("form", ["cvat", "xtreme1"])
def test_an_export_without_the_answer_of_its_tool_has_no_labels(
    world: ExportWorld, tmp_path: Path, form: str
) -> None:
    places_of(world, form, tmp_path / "out")
    with pytest.raises(UsageError, match=f"no frame of this export has labels of format {form}"):
        imported(tmp_path / "out", form)


def need_same(
    scene: ImportedScene, expected: Sequence[Labelled], indices: Sequence[NDArray[np.int64]]
) -> None:
    """Compare the labels of all raw points; those that were not exported have none."""
    assert [frame.number for frame in scene.frames] == list(range(len(expected)))
    objects: dict[int, int] = {}
    for frame, want, index in zip(scene.frames, expected, indices, strict=True):
        rest = np.delete(np.arange(len(frame.words)), index)
        assert not frame.words[rest].any()
        assert not frame.motion[rest].any()
        np.testing.assert_array_equal(frame.words[index] & 0xFFFF, want.classes)
        np.testing.assert_array_equal(frame.motion[index], want.motion)
        found = (frame.words[index] >> 16).astype(int)
        if want.objects is not None:
            np.testing.assert_array_equal(found, want.objects)
        if want.named is not None:
            assert ((found == 0) == (want.named == -1)).all()
            for name in {*want.named.tolist()} - {-1}:
                (number,) = {*found[want.named == name].tolist()}
                assert objects.setdefault(name, number) == number
    assert len({*objects.values()}) == len(objects)
