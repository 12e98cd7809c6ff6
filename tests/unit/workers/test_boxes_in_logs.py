"""Boxes of a model, from a written log to its frames: spaces, times, and bad input."""

import numpy as np
import pytest

from schemas.transport.bucket import open_bucket
from tests.box_logs import OBJECTS, Put, boxes_at, clouds, read, stamp, transform, write
from tests.box_messages import Box, detections, published
from tests.tiny_logs import LIDAR, only_recording, settings
from workers.ingest.plan import plan_recording

LATE_NS = 150_000_000


def answers(*, frame_id: str = "lidar", shift: float = 0.0, **changes: object) -> list[Put]:
    """One answer per cloud, logged later than the next cloud."""
    return [
        Put(
            OBJECTS,
            stamp(number) + LATE_NS,
            detections(
                boxes_at(**changes),  # type: ignore[arg-type]
                stamp_ns=stamp(number + shift),
                frame_id=frame_id,
            ),
        )
        for number in range(20)
    ]


def test_every_cloud_gets_the_boxes_with_its_stamp() -> None:
    frames, said = read(write([*clouds(), *answers(class_name="van", track_id="7")]))
    assert said == []
    assert len(frames) == 20
    for frame in frames:
        assert frame.boxes is not None
        assert frame.boxes.stamp_ns == frame.stamp_ns
        assert frame.boxes.class_name == ("van",)
        assert frame.boxes.movable == (True,)
        np.testing.assert_allclose(frame.boxes.centre_m, [(5.0, 1.0, 0.0)])


def test_a_static_transform_places_boxes_of_another_frame() -> None:
    log = write(
        [
            *clouds(),
            *answers(frame_id="base"),
            transform("base", "lidar", 2.0, log_time_ns=stamp(0)),
        ]
    )
    frames, said = read(log)
    assert said == []
    assert frames[3].boxes is not None
    np.testing.assert_allclose(frames[3].boxes.centre_m, [(3.0, 1.0, 0.0)])


def test_a_moving_transform_counts_at_the_time_of_the_boxes() -> None:
    moving = [
        transform("map", "base", 10.0 * number, log_time_ns=stamp(number), topic="/tf")
        for number in range(21)
    ]
    fixed = transform("base", "lidar", 1.0, log_time_ns=stamp(0))
    frames, said = read(
        write([*clouds(), *answers(frame_id="map", x_m=100.0, shift=0.25), *moving, fixed])
    )
    assert said == []
    for number, frame in enumerate(frames):
        assert frame.boxes is not None
        assert frame.boxes.stamp_ns == stamp(number + 0.25)
        at = 100.0 - 1.0 - 10.0 * (number + 0.25)
        np.testing.assert_allclose(frame.boxes.centre_m, [(at, 1.0, 0.0)], atol=1e-6)


def test_an_unknown_frame_is_said_once_and_its_frames_have_no_answer() -> None:
    frames, said = read(write([*clouds(), *answers(frame_id="nowhere")]))
    assert [frame.boxes for frame in frames] == [None] * 20
    (sentence,) = said
    assert "20 answers in boxes are in the frame 'nowhere'" in sentence
    assert "no transform of the log names it" in sentence
    assert "/tf_static" in sentence


def test_answers_of_another_clock_match_no_cloud() -> None:
    frames, said = read(write([*clouds(), *answers(shift=36_000.0)]))
    assert [frame.boxes for frame in frames] == [None] * 20
    assert any("20 clouds have no answer of the model" in each for each in said)


def test_half_the_rate_leaves_every_second_cloud_without_an_answer() -> None:
    frames, said = read(write([*clouds(), *answers()[::2]]))
    assert [frame.boxes is not None for frame in frames] == [True, False] * 10
    assert any("10 clouds have no answer" in each for each in said)


def test_an_answer_without_boxes_is_an_answer() -> None:
    nothing = [
        Put(OBJECTS, stamp(number), detections([], stamp_ns=stamp(number), frame_id="lidar"))
        for number in range(20)
    ]
    frames, said = read(write([*clouds(), *nothing]))
    assert said == []
    assert all(frame.boxes is not None and not len(frame.boxes) for frame in frames)


def test_classes_that_nobody_mapped_are_named_once() -> None:
    frames, said = read(write([*clouds(), *answers(class_name="gizmo")]))
    assert frames[0].boxes is not None
    assert frames[0].boxes.movable == (None,)
    (sentence,) = said
    assert "'gizmo'" in sentence
    assert "counterpoint.classes" in sentence


@pytest.mark.parametrize("named", ["gizmo", "12"])
def test_the_classes_of_the_log_map_by_name_and_by_number(named: str) -> None:
    classes: dict[str, dict[str, object]] = {
        "12": {"name": "gizmo", "movable": False, "moving": False}
    }
    log = write([*clouds(), *answers(class_name=named)], classes=classes)
    frames, said = read(log)
    assert said == []
    assert frames[0].boxes is not None
    assert frames[0].boxes.class_name == ("gizmo",)
    assert frames[0].boxes.movable == (False,)


def test_impossible_boxes_are_counted_and_the_others_used() -> None:
    bad = [Box((float("nan"), 0.0, 0.0)), Box((1.0, 2.0, 0.0), size_m=(0.0, 1.0, 1.0))]
    messages = [
        Put(
            OBJECTS,
            stamp(number),
            detections([*bad, *boxes_at()], stamp_ns=stamp(number), frame_id="lidar"),
        )
        for number in range(20)
    ]
    frames, said = read(write([*clouds(), *messages]))
    assert all(frame.boxes is not None and len(frame.boxes) == 1 for frame in frames)
    assert any("20 boxes have numbers that are not finite" in each for each in said)
    assert any("20 boxes have a side of zero" in each for each in said)


def test_a_message_of_too_many_boxes_costs_its_own_frame_only() -> None:
    many = published(boxes_at() * 5_000, stamp_ns=stamp(4), frame_id="lidar")
    messages = [
        Put(
            OBJECTS,
            stamp(number),
            many
            if number == 4
            else published(boxes_at(), stamp_ns=stamp(number), frame_id="lidar"),
        )
        for number in range(20)
    ]
    frames, said = read(write([*clouds(), *messages]))
    assert [number for number, frame in enumerate(frames) if frame.boxes is None] == [4]
    assert any("cannot read boxes" in each for each in said)


def test_a_log_without_any_answer_is_refused_and_names_what_was_looked_for() -> None:
    bucket = open_bucket("memory://")
    bucket.put("drive.mcap", write(clouds()))
    plan = plan_recording(bucket, only_recording(bucket), settings(supervised="recorded"))
    assert LIDAR in plan.refused
    assert "no topic has boxes of a known type" in plan.refused


def test_a_log_with_boxes_that_no_setting_uses_says_so() -> None:
    bucket = open_bucket("memory://")
    bucket.put("drive.mcap", write([*clouds(), *answers()]))
    unread: list[str] = []
    plan_recording(bucket, only_recording(bucket), settings(), on_unread_labels=unread.append)
    assert unread == [OBJECTS]
