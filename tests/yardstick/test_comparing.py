"""What the yardstick calls a difference."""

from dataclasses import replace
from typing import Any

from schemas.canonical import sha256
from schemas.score import SceneScore
from schemas.transport.overlay_codec import decode_overlay, encode_overlay
from tests.unit.workers.test_rescored_scene import mine
from tests.yardstick.comparing import differences, other_texts
from tests.yardstick.frozen import FrozenScene, Yardstick, frozen_scene
from workers.contradiction.scoring_inputs import decode_inputs, encode_inputs
from workers.mine import MinedRecord


def mined(score: SceneScore, record: bytes, overlay: bytes) -> MinedRecord:
    return MinedRecord(score, record, sha256(record), overlay, overlay_key="")


def state(log: str = "0", **changed: Any) -> Yardstick:
    scene = {
        "scene_id": "a/lidar/1",
        "producers": {"pipeline_version": "p1"},
        "texts": {"reasons": ["seen through"]},
        "values": {"score": 0.5, "tracks.0.strength": 0.25},
        "overlay": {"agreements": "0f"},
    }
    return Yardstick(
        simulated_log=log, runs={"kitti": (FrozenScene.model_validate(scene | changed),)}
    )


def test_other_producers_are_no_difference() -> None:
    other = state(producers={"pipeline_version": "p2"})
    assert list(differences(state(), other)) == []
    assert list(other_texts(state(), other)) == []


def test_inputs_of_a_score_by_other_producers_are_no_difference() -> None:
    one, other = (frozen_scene(mined(*mine(version))) for version in ("p1", "p2"))
    assert one.producers != other.producers
    assert (one.values, one.overlay) == (other.values, other.overlay)
    score, record, overlay = mine("p1")
    file = decode_overlay(overlay)
    inputs = decode_inputs(file.scoring_inputs)
    inputs = replace(inputs, statistics=replace(inputs.statistics, remark="another"))
    file = replace(file, scoring_inputs=encode_inputs(inputs))
    changed = frozen_scene(mined(score, record, encode_overlay(file)))
    assert {name for name in one.overlay if one.overlay[name] != changed.overlay[name]} == {
        "scoring_inputs"
    }


def test_other_words_are_named_apart() -> None:
    other = state(texts={"reasons": ["through it was seen"]})
    assert list(differences(state(), other)) == []
    (line,) = other_texts(state(), other)
    assert "reasons: ['seen through'] became ['through it was seen']" in line


def test_the_first_value_that_differs_is_named() -> None:
    (line,) = differences(state(), state(values={"score": 0.5, "tracks.0.strength": 0.26}))
    assert line == "kitti a/lidar/1: 1 fields differ, first tracks.0.strength: 0.25 became 0.26"


def test_a_field_that_is_gone_or_new_is_a_difference() -> None:
    (line,) = differences(state(), state(values={"score": 0.5}))
    assert "tracks.0.strength: 0.25 became '(absent)'" in line


def test_another_overlay_is_a_difference() -> None:
    (line,) = differences(state(), state(overlay={"agreements": "1f"}))
    assert "overlay.agreements" in line


def test_a_scene_that_is_missing_is_a_difference() -> None:
    without = Yardstick(simulated_log="0", runs={"kitti": ()})
    assert list(differences(state(), without)) == ["kitti a/lidar/1: mined only before"]
    assert list(differences(without, state())) == ["kitti a/lidar/1: mined only after"]


def test_another_simulated_log_is_a_difference() -> None:
    assert len(list(differences(state(), state(log="1")))) == 1
