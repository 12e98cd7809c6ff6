"""Formats without points: OpenLABEL, Label Studio, Parquet and JSON, read by others' programs."""

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from service.export.scene import JudgedTrack
from tests.export_world import FRAMES, ExportWorld, made_world, record
from tests.readers.environment import read_by


@pytest.fixture
def world(tmp_path: Path) -> ExportWorld:
    made = made_world(tmp_path)
    made.verdicts = (JudgedTrack(track_id=0, reviewer="ada", verdict="supervised"),)
    return made


def test_openlabel_follows_its_published_schema(world: ExportWorld, tmp_path: Path) -> None:
    report = world.export(world.selection(scenes=1), "openlabel", tmp_path / "out")
    (written,) = report.written.values()
    read = read_by("read_openlabel", tmp_path / "out" / written.place)
    assert "openlabel" in read["schema"]
    assert read["errors"] == []


def test_openlabel_has_a_cuboid_of_each_track_in_its_frames(
    world: ExportWorld, tmp_path: Path
) -> None:
    report = world.export(world.selection(scenes=1), "openlabel", tmp_path / "out")
    (written,) = report.written.values()
    document = json.loads((tmp_path / "out" / written.place).read_text())["openlabel"]
    assert document["objects"]["0"]["type"] == "car"
    assert document["objects"]["0"]["frame_intervals"] == [
        {"frame_start": 0, "frame_end": FRAMES - 1}
    ]
    (cuboid,) = document["frames"]["3"]["objects"]["0"]["object_data"]["cuboid"]
    assert cuboid["val"][:3] == [9, -4, 0]
    assert cuboid["val"][7:] == [4, 2, 1.5]
    assert document["metadata"]["counterpoint"]["verdicts"][0]["reviewer"] == "ada"


def test_label_studio_takes_the_interface_the_tasks_and_the_predictions(
    world: ExportWorld, tmp_path: Path
) -> None:
    world.export(world.selection(), "labelstudio", tmp_path / "out")
    read = read_by("read_labelstudio", tmp_path / "out")
    assert read == [{"task": True, "predictions": [True]}] * 2


def test_label_studio_tasks_show_a_picture_that_exists(world: ExportWorld, tmp_path: Path) -> None:
    world.export(world.selection(), "labelstudio", tmp_path / "out")
    tasks = json.loads((tmp_path / "out/tasks.json").read_text())
    for task in tasks:
        path = task["data"]["image"].removeprefix("/data/local-files/?d=")
        assert (tmp_path / "out" / path).read_bytes().startswith(b"\x89PNG")
    (result,) = tasks[0]["predictions"][0]["result"]
    assert result["value"] == {"choices": ["supervised"]}


def test_parquet_has_a_row_for_each_scene_and_each_track(
    world: ExportWorld, tmp_path: Path
) -> None:
    world.export(world.selection(), "parquet", tmp_path / "out")
    scenes = pq.read_table(tmp_path / "out/scenes.parquet").to_pylist()
    tracks = pq.read_table(tmp_path / "out/tracks.parquet").to_pylist()
    assert [row["scene_id"] for row in scenes] == [record(0).scene_id, record(1).scene_id]
    assert [row["rank"] for row in scenes] == [1, 2]
    assert scenes[0]["contradicting_share"] == pytest.approx(0.04)
    assert scenes[0]["end"] > scenes[0]["start"]
    assert [(row["scene_id"], row["wrong"]) for row in tracks] == [
        (record(0).scene_id, "supervised"),
        (record(1).scene_id, "supervised"),
    ]
    assert json.loads(tracks[0]["verdicts"])[0]["verdict"] == "supervised"


def test_json_has_the_rows_of_the_selection_with_the_verdicts(
    world: ExportWorld, tmp_path: Path
) -> None:
    world.export(world.selection(), "json", tmp_path / "out")
    lines = (tmp_path / "out/scenes.jsonl").read_text().splitlines()
    assert [json.loads(line)["rank"] for line in lines] == [1, 2]
    assert json.loads(lines[0])["verdicts"][0]["reviewer"] == "ada"
