"""Format `mcap`, read back by the `mcap` reader with the decoders of each schema."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as Protobuf
from mcap_ros2.decoder import DecoderFactory as Ros2

from service.export.scene import JudgedTrack
from tests.export_world import (
    FRAMES,
    MOVER,
    STEP_NS,
    ExportWorld,
    made_world,
    record,
    returns,
    static_transform,
    write_log,
)
from tests.needed import needed
from tests.tiny_logs import BEGIN_NS, LIDAR

COLOUR_OF_SELF_SUPERVISED_ALONE = (178, 34, 34)


@pytest.fixture(scope="module")
def excerpt(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mcap")
    world = made_world(folder)
    world.verdicts = (JudgedTrack(track_id=0, reviewer="ada", verdict="supervised"),)
    report = world.export(world.selection(scenes=1), "mcap", folder / "out")
    assert report.missing == {}
    (written,) = report.written.values()
    return folder / "out" / written.place


def raw_messages(path: Path, topic: str) -> list[tuple[int, int, bytes]]:
    with path.open("rb") as file:
        found = make_reader(file).iter_messages(topics=[topic])
        return [(m.log_time, m.publish_time, m.data) for _, _, m in found]


def decoded(path: Path, topic: str) -> list[Any]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[Protobuf(), Ros2()])
        return [each for _, _, _, each in reader.iter_decoded_messages(topics=[topic])]


def test_raw_messages_are_those_of_the_log_around_the_scene_byte_for_byte(excerpt: Path) -> None:
    log = excerpt.parents[1] / "logs/car-7/2026-11-20/drive.mcap"
    start_ns = record().start_ns
    end_ns = start_ns + (FRAMES - 1) * STEP_NS
    near = [
        each
        for each in raw_messages(log, LIDAR)
        if start_ns - 9 * STEP_NS <= each[0] <= end_ns + 9 * STEP_NS
    ]
    copied = raw_messages(excerpt, LIDAR)
    assert set(near) <= set(copied) <= set(raw_messages(log, LIDAR))
    assert len(copied) < len(raw_messages(log, LIDAR))
    assert raw_messages(excerpt, "/other/points") == []


def test_transforms_recorded_once_at_the_begin_come_first(excerpt: Path) -> None:
    ((log_time, published, data),) = raw_messages(excerpt, "/tf_static")
    assert (published, data) == (BEGIN_NS, static_transform())
    assert log_time <= raw_messages(excerpt, LIDAR)[0][0]
    (message,) = decoded(excerpt, "/tf_static")
    assert message.transforms[0].child_frame_id == "lidar"


def test_overlay_has_each_return_with_its_index_colour_category_and_score(excerpt: Path) -> None:
    clouds = decoded(excerpt, "/counterpoint/points")
    assert len(clouds) == FRAMES
    first = clouds[0]
    names = {1: "u1", 3: "<u2", 4: "<i2", 5: "<u4", 7: "<f4"}
    kind = np.dtype(
        {
            "names": [field.name for field in first.fields],
            "formats": [names[field.type] for field in first.fields],
            "offsets": [field.offset for field in first.fields],
            "itemsize": first.point_stride,
        }
    )
    points = np.frombuffer(first.data, dtype=kind)
    np.testing.assert_array_equal(points["index"], returns())
    moving = np.isin(points["index"], MOVER)
    assert {tuple(row) for row in points[["red", "green", "blue"]][moving].tolist()} == {
        COLOUR_OF_SELF_SUPERVISED_ALONE
    }
    np.testing.assert_allclose(points["score"], np.where(moving, 0.75, 0.0))
    assert set(points["category"][moving]) == {2}
    assert set(points["label"][moving]) == {252}
    assert first.frame_id == "lidar"


def test_boxes_and_events_describe_the_tracks_of_the_record(excerpt: Path) -> None:
    updates = decoded(excerpt, "/counterpoint/boxes")
    assert [len(update.entities) for update in updates] == [1] * FRAMES
    entity = updates[0].entities[0]
    size = entity.cubes[0].size
    assert (size.x, size.y, size.z) == pytest.approx((4, 2, 1.5))
    assert entity.lifetime.nanos == STEP_NS
    scene, track = decoded(excerpt, "/counterpoint/events")
    told = {each.key: each.value for each in scene.metadata}
    assert told["scene_id"] == record().scene_id
    assert json.loads(told["verdicts"])[0]["reviewer"] == "ada"
    about = {each.key: each.value for each in track.metadata}
    assert (about["track_id"], about["wrong"]) == ("0", "supervised")


def test_metadata_of_the_log_and_the_record_are_in_the_file(excerpt: Path) -> None:
    with excerpt.open("rb") as file:
        reader = make_reader(file)
        kept = {each.name: each.metadata for each in reader.iter_metadata()}
        (attachment,) = reader.iter_attachments()
        summary = reader.get_summary()
    assert kept["licence"] == {"name": "CC BY 4.0"}
    assert kept["counterpoint.scene"]["selection"] == "week"
    assert json.loads(attachment.data)["record"]["scene_id"] == record().scene_id
    assert summary is not None
    assert summary.chunk_indexes


def test_the_layout_shows_the_overlay(excerpt: Path) -> None:
    layout = json.loads((excerpt.parent / "layout.foxglove.json").read_text())
    panel = layout["configById"]["3D!counterpoint"]
    assert panel["topics"]["/counterpoint/points"]["colorMode"] == "rgba-fields"
    assert layout["layout"]["first"] == "3D!counterpoint"


def test_a_scene_across_the_parts_of_a_split_recording_is_one_excerpt(
    excerpt: Path, tmp_path: Path
) -> None:
    bucket = tmp_path / "logs"
    write_log(bucket, frames=22, part="_0")
    write_log(bucket, first=22, part="_1")
    world = ExportWorld(bucket)
    report = world.export(world.selection(scenes=1), "mcap", tmp_path / "out")
    assert report.missing == {}
    (written,) = report.written.values()
    split = tmp_path / "out" / written.place
    for topic in (LIDAR, "/tf_static", "/counterpoint/points", "/counterpoint/boxes"):
        assert raw_messages(split, topic) == raw_messages(excerpt, topic)


@pytest.mark.parametrize("form", ["mcap", "rerun"])
def test_rerun_opens_what_is_written(form: str, tmp_path: Path) -> None:
    needed("rerun", "the extra `rerun`")
    world = made_world(tmp_path)
    report = world.export(world.selection(scenes=1), form, tmp_path / "out")
    (written,) = report.written.values()
    path = tmp_path / "out" / written.place
    run = [sys.executable, "-m", "rerun"]
    if form == "mcap":
        recording = tmp_path / "converted.rrd"
        subprocess.run(
            [*run, "mcap", "convert", str(path), "-o", str(recording)],
            check=True,
            capture_output=True,
        )
        path = recording
    verified = subprocess.run(
        [*run, "rrd", "verify", str(path)], check=True, capture_output=True, text=True
    )
    assert "verified without error" in verified.stdout + verified.stderr
    stats = subprocess.run(
        [*run, "rrd", "stats", str(path)], check=True, capture_output=True, text=True
    )
    points = "/counterpoint/points" if form == "mcap" else "/odom/lidar/points"
    assert points in stats.stdout
