"""First view of a recording, and the colours of boxes in what viewers open."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from schemas.labels import Agreement
from schemas.overlay import Overlay
from schemas.score import SceneScore
from service.export.rerun_recording import first_view
from service.pictures.style import WITNESS_INK
from tests import export_world
from tests.export_world import FRAMES, made_world, overlay, record


def test_the_first_view_looks_at_the_strongest_track_from_the_side_of_the_car() -> None:
    score, shown = record(), overlay(record())
    view = first_view(score, shown)
    assert view is not None
    eye_m, seen_m = view
    best = int(np.argmin(np.abs(shown.stamps_ns - score.tracks[0].strongest.stamp_ns)))
    car_m = shown.odom_from_sensor[best][:3, 3]
    np.testing.assert_allclose(seen_m, shown.instance_boxes[best, :3] + car_m, atol=1e-5)
    assert np.linalg.norm(eye_m[:2] - car_m[:2]) < np.linalg.norm(seen_m[:2] - car_m[:2])
    assert eye_m[2] > seen_m[2]


def test_a_scene_without_contradictions_has_no_first_view() -> None:
    quiet = record().model_copy(update={"tracks": (), "reasons": ()})
    assert first_view(quiet, overlay(record())) is None


def test_boxes_of_the_witness_alone_have_its_colour_though_their_points_are_green(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def witnessed(score: SceneScore) -> Overlay:
        kinds = np.full(FRAMES, Agreement.BOTH_STATIC, dtype=np.uint8)
        return replace(overlay(score), instance_kind=kinds)

    world = made_world(tmp_path)
    monkeypatch.setattr(export_world, "overlay", witnessed)
    report = world.export(world.selection(scenes=1), "mcap", tmp_path / "out")
    (written,) = report.written.values()
    with (tmp_path / "out" / written.place).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        updates = [m for *_, m in reader.iter_decoded_messages(topics=["/counterpoint/boxes"])]
    colour = updates[0].entities[0].cubes[0].color
    assert (colour.r, colour.g, colour.b) == pytest.approx([c / 255 for c in WITNESS_INK])
