import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from schemas.predicted_boxes import SCHEMA_NAME
from workers.lab.simulation.faults.detected_boxes import DetectedBox
from workers.lab.simulation.faults.detector import Detector
from workers.lab.simulation.faults.faults import DYNAMIC, PlantedFailure
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.faults.street_bodies import street_bodies
from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.output.box_messages import BOXES_TOPIC
from workers.lab.simulation.output.write import write_log
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar, SimulatedFrame, sweep
from workers.lab.simulation.world.motion_along_road import Road, drive_along, stand
from workers.lab.simulation.world.street import Actor, Street

LIDAR = Lidar(elevation_deg=UNEVEN_64[::2], columns=512)
BUS, PARKED = 0, 1
LASTS_S = 4.0


@pytest.fixture(scope="module")
def street() -> Street:
    road = Road.bending(from_m=-60.0, to_m=120.0, swing_rad=0.0, wave_m=300.0)
    drive = drive_along(
        road,
        from_m=4.0,
        across_m=6.0,
        speed=[(0.0, 3.0), (9.0, 3.0)],
        seconds=LASTS_S,
        backwards=False,
    )
    return Street.of(
        seed=3,
        seconds=LASTS_S,
        ego=stand(road, at_m=0.0, across_m=0.0),
        actors=[
            Actor(StreetClass.BUS, drive),
            Actor(StreetClass.CAR, stand(road, at_m=9.0, across_m=-6.0), parked=True),
        ],
        fixed=[],
        even=True,
    )


@pytest.fixture(scope="module")
def frames(street: Street) -> list[SimulatedFrame]:
    return [sweep(street, LIDAR, index) for index in range(40)]


def boxes_of(
    street: Street, frames: list[SimulatedFrame], *failures: PlantedFailure
) -> list[tuple[DetectedBox, ...]]:
    detector = Detector(street.seed, len(street.actors))
    return [
        detector.detect(frame, street_bodies(street, frame.time_s), failures) for frame in frames
    ]


def named(boxes: tuple[DetectedBox, ...], what: StreetClass) -> list[DetectedBox]:
    return [box for box in boxes if box.class_name == what.name.lower() and box.score > 0.5]


def failure(kind: FailureKind, track: int, **changes: object) -> PlantedFailure:
    return replace(PlantedFailure(kind, track, 1.0, 3.0), **changes)  # type: ignore[arg-type]


def test_boxes_lie_on_their_objects_with_small_errors(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    away, speeds, covered, missing = [], [], [], 0
    for frame, boxes in zip(frames, boxes_of(street, frames), strict=True):
        found = named(boxes, StreetClass.BUS)
        missing += not found
        for box in found:
            x, y, _ = street.actor_poses(frame.time_s)[BUS] - street.ego.pose(frame.time_s)
            away.append(float(np.hypot(box.centre_m[0] - x, box.centre_m[1] - y)))
            speeds.append(float(np.hypot(*box.velocity_m_per_s)))
            points = frame.points_m[frame.track == BUS] - box.centre_m
            inside = (np.abs(points) <= np.array(box.size_m) / 2 + 0.4).all(axis=1)
            covered.append(float(inside.mean()))
    assert 0.0 < np.median(away) < 0.3
    assert np.median(speeds) == pytest.approx(3.0, abs=0.3)
    assert np.median(covered) > 0.8
    assert missing < 8


def test_boxes_depend_on_the_seed_alone(street: Street, frames: list[SimulatedFrame]) -> None:
    assert boxes_of(street, frames) == boxes_of(street, frames)


def test_an_id_lasts_and_a_lost_object_gets_another_one(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    ids = [box.track_id for boxes in boxes_of(street, frames) for box in named(boxes, _CAR)]
    assert len(set(ids)) <= 2
    hidden = [
        replace(frame, track=np.where(frame.track == PARKED, -1, frame.track).astype(np.int16))
        if 10 <= frame.index < 20
        else frame
        for frame in frames
    ]
    detected = boxes_of(street, hidden)
    before = {box.track_id for boxes in detected[:10] for box in named(boxes, _CAR)}
    after = {box.track_id for boxes in detected[20:] for box in named(boxes, _CAR)}
    assert before
    assert after
    assert not before & after
    assert not named(detected[20], _CAR)  # the tracker reports it some frames late


_CAR = StreetClass.CAR


def test_a_log_begins_amid_a_drive_so_a_miss_in_its_first_frame_is_coasted_over(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    bodies = street_bodies(street, frames[0].time_s)
    for seed in range(200):
        detector = Detector(seed, len(street.actors))
        boxes = detector.detect(frames[0], bodies, [])
        assert len(named(boxes, StreetClass.BUS)) == 1, seed
        assert len(named(boxes, _CAR)) == 1, seed


@pytest.mark.parametrize("kind", [FailureKind.UNSEEN_CLASS, FailureKind.LATE_DETECTION])
def test_a_missed_mover_has_no_box(
    street: Street, frames: list[SimulatedFrame], kind: FailureKind
) -> None:
    detected = boxes_of(street, frames, failure(kind, BUS))
    assert not any(named(boxes, StreetClass.BUS) for boxes in detected[10:30])
    assert any(named(boxes, StreetClass.BUS) for boxes in detected[30:])


def test_a_mover_of_a_regressed_version_has_a_box_that_stands(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    detected = boxes_of(street, frames, failure(FailureKind.VERSION_REGRESSION, BUS))
    speeds = [
        np.hypot(*box.velocity_m_per_s)
        for boxes in detected[10:30]
        for box in named(boxes, StreetClass.BUS)
    ]
    assert np.median(speeds) < 0.3


def test_a_parked_car_and_a_ghost_have_boxes_that_move(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    ghost = failure(FailureKind.GHOST_MOVER, -1, place_m=(12.0, 2.0, 1.0))
    parked = failure(FailureKind.PARKED_CALLED_MOVING, PARKED)
    detected = boxes_of(street, frames, ghost, parked)
    during = [box for boxes in detected[10:30] for box in boxes if box.class_name == "car"]
    moving = [box for box in during if np.hypot(*box.velocity_m_per_s) > 1.0]
    assert len({box.track_id for box in moving}) >= 2
    quiet = [box for boxes in boxes_of(street, frames)[10:30] for box in named(boxes, _CAR)]
    assert np.median([np.hypot(*box.velocity_m_per_s) for box in quiet]) < 0.4


def test_a_half_labelled_bus_has_a_box_around_the_other_part(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    half = failure(FailureKind.HALF_LABELLED, BUS, part=0.7)
    detected = boxes_of(street, frames, half)
    whole = street.actors[BUS].size_m[0]
    lengths = [box.size_m[0] for boxes in detected[10:30] for box in named(boxes, StreetClass.BUS)]
    assert np.median(lengths) == pytest.approx(0.3 * whole, rel=0.2)


def test_a_log_of_a_detector_has_one_message_of_boxes_per_cloud(
    street: Street, frames: list[SimulatedFrame], tmp_path: Path
) -> None:
    file = tmp_path / "log.mcap"
    write_log(file, street, lidar=LIDAR, recorded="boxes", frames=10)
    with file.open("rb") as stream:
        messages = [
            (schema, json.loads(message.data))
            for schema, channel, message in make_reader(stream).iter_messages(topics=[BOXES_TOPIC])
        ]
    assert len(messages) == 10
    assert {schema.name for schema, _ in messages if schema} == {SCHEMA_NAME}
    expected = boxes_of(street, frames[:10])
    for (_, message), boxes in zip(messages, expected, strict=True):
        assert [each["track_id"] for each in message["boxes"]] == [str(b.track_id) for b in boxes]
        assert (np.array([each["size_m"] for each in message["boxes"]]) > 0).all()
    assert (frames[0].motion == DYNAMIC).any()
