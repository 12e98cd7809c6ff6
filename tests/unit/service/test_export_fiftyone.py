"""Format `fiftyone`: the layout that its importer reads, by that importer where it is installed."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.export_world import FRAMES, made_world, record
from tests.readers.environment import read_by


@pytest.fixture
def out(tmp_path: Path) -> Path:
    world = made_world(tmp_path)
    world.export(world.selection(), "fiftyone", tmp_path / "out")
    return tmp_path / "out"


def samples(out: Path) -> list[dict[str, Any]]:
    return list(json.loads((out / "samples.json").read_text())["samples"])


def test_each_frame_is_a_sample_whose_media_lie_in_the_folder(out: Path) -> None:
    found = samples(out)
    assert [each["frame"] for each in found] == [*range(FRAMES), *range(FRAMES)]
    assert found[0]["scene_id"] == record(0).scene_id
    for each in found:
        path = out / each["filepath"]
        (cloud,) = json.loads(path.read_text())["children"]
        assert (path.parent / cloud["pcdPath"]).read_bytes().startswith(b"# .PCD v0.7")
    about = json.loads((out / "metadata.json").read_text())
    assert "version" not in about, "the importer takes a version for a document of its database"
    assert (about["media_type"], about["info"]["selection"]) == ("3d", "week")


def test_contradictions_are_boxes_with_their_track_and_attribution(out: Path) -> None:
    (box,) = samples(out)[3]["contradictions"]["detections"]
    assert (box["location"], box["dimensions"]) == ([9.0, -4.0, 0.0], [4.0, 2.0, 1.5])
    assert (box["label"], box["index"], box["wrong"]) == ("car", 0, "supervised")
    assert box["rotation"][2] == pytest.approx(0.3)


def test_points_of_a_cloud_name_their_place_in_the_raw_message(out: Path) -> None:
    path = out / samples(out)[0]["filepath"]
    header, _, data = path.with_suffix(".pcd").read_bytes().partition(b"DATA binary\n")
    assert header.count(b"\n") > 8
    places = [index for *_, index in struct.iter_unpack("<4fII", data)]
    index = np.fromfile(path.parent / "index" / "000000.bin", dtype="<u4")
    assert places == index.tolist()


def test_the_importer_of_fiftyone_reads_the_samples(out: Path) -> None:
    read = read_by("read_fiftyone", out, environment="fiftyone")
    assert read["selection"] == "week"
    assert [each["frame"] for each in read["samples"]] == [*range(FRAMES), *range(FRAMES)]
    assert {each["media"] for each in read["samples"]} == {"3d"}
    assert read["samples"][0]["labels"] == ["car"]
