from dataclasses import replace

import numpy as np
import pytest

from tests.factories import SMALL_LIDAR
from workers.lab.simulation.faults.confidence import draw_confidence
from workers.lab.simulation.faults.disturbances import (
    Disturbance,
    delay_ns,
    disturb,
    draw_disturbance,
    only_points,
)
from workers.lab.simulation.faults.plan import SCENE_S, DisturbanceKind, PlannedDisturbance
from workers.lab.simulation.faults.recorded import record
from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.sensor.lidar import SimulatedFrame, sweep
from workers.lab.simulation.world.street import Street
from workers.lab.simulation.world.street_builder import build_street


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(4, seconds=4.0, style="drives")


@pytest.fixture(scope="module")
def frame(street: Street) -> SimulatedFrame:
    return sweep(street, SMALL_LIDAR, 25)


def drawn(kind: DisturbanceKind, cell: int = 1) -> Disturbance:
    return draw_disturbance(PlannedDisturbance(cell, kind, seed=7))


@pytest.mark.parametrize("kind", DisturbanceKind)
def test_a_disturbance_stays_in_its_scene(street: Street, kind: DisturbanceKind) -> None:
    each = drawn(kind)
    assert SCENE_S <= each.start_s < each.end_s <= 2 * SCENE_S
    before = sweep(street, SMALL_LIDAR, 15)
    assert disturb(before, [each]) is before


@pytest.mark.parametrize("kind", DisturbanceKind)
def test_recorded_labels_stay_right_under_a_disturbance(
    street: Street, frame: SimulatedFrame, kind: DisturbanceKind
) -> None:
    disturbed = disturb(frame, [drawn(kind)])
    said = record(street, disturbed, ())
    np.testing.assert_array_equal(said.motion, disturbed.motion)
    assert len(said.label) == len(disturbed)


@pytest.mark.parametrize("things", [250, 300])
def test_a_street_of_hundreds_of_things_is_recorded_as_any(
    street: Street, frame: SimulatedFrame, things: int
) -> None:
    crowd = (street.actors * things)[:things]
    said = record(replace(street, actors=crowd), frame, ())
    sure, _ = draw_confidence(
        seed=street.seed,
        things=things + 1 + max(StreetClass),
        time_s=frame.time_s,
        index=frame.index,
    )
    nobodys = frame.track < 0
    of_class = sure[things + frame.class_id[nobodys].astype(np.int64)]
    np.testing.assert_allclose(said.confidence[nobodys], of_class, atol=1e-3)
    of_thing = sure[frame.track[~nobodys]]
    np.testing.assert_allclose(said.confidence[~nobodys], of_thing, atol=1e-3)


def test_a_dropped_sector_holds_no_return_and_the_rest_is_as_it_was(frame: SimulatedFrame) -> None:
    each = drawn(DisturbanceKind.DROPPED_SECTOR)
    disturbed = disturb(frame, [each])
    away = np.arctan2(disturbed.points_m[:, 1], disturbed.points_m[:, 0]) - each.azimuth_rad
    assert (np.abs((away + np.pi) % (2 * np.pi) - np.pi) >= each.width_rad / 2 - 1e-6).all()
    assert 0 < len(disturbed) < len(frame)
    assert len(disturbed.track) == len(disturbed.motion) == len(disturbed)


def test_a_ground_leak_lifts_ground_and_nothing_else(frame: SimulatedFrame) -> None:
    disturbed = disturb(frame, [drawn(DisturbanceKind.GROUND_LEAK)])
    lifted = disturbed.points_m[:, 2] > frame.points_m[:, 2] + 0.05
    assert lifted.any()
    assert (frame.ground[lifted] == 1).all()
    np.testing.assert_array_equal(disturbed.points_m[~lifted], frame.points_m[~lifted])


def test_a_swapped_sensor_has_half_the_beams(frame: SimulatedFrame) -> None:
    disturbed = disturb(frame, [drawn(DisturbanceKind.SENSOR_SWAP)])
    assert len(set(disturbed.ring.tolist())) <= len(SMALL_LIDAR.elevation_deg) // 2


def test_another_scale_of_intensity_moves_no_point(frame: SimulatedFrame) -> None:
    disturbed = disturb(frame, [drawn(DisturbanceKind.INTENSITY_SCALE)])
    assert not np.array_equal(disturbed.intensity, frame.intensity)
    np.testing.assert_array_equal(disturbed.points_m, frame.points_m)


def test_stamps_under_jitter_come_late_but_never_the_first_and_never_into_the_next_scene() -> None:
    each = drawn(DisturbanceKind.TIME_JITTER, cell=0)
    late = [delay_ns(index, index * 0.1, [each]) for index in range(25)]
    assert late[0] == 0
    assert all(0 <= ns < 50_000_000 for ns in late)
    assert any(late[1:20])
    assert not any(late[20:])


def test_a_slip_changes_nothing_that_a_sensor_measures(frame: SimulatedFrame) -> None:
    each = drawn(DisturbanceKind.ODOMETRY_SLIP)
    disturbed = disturb(frame, [each])
    np.testing.assert_array_equal(disturbed.points_m, frame.points_m)
    assert each.strength != 0.0


def test_every_array_of_a_frame_is_cut_alike(frame: SimulatedFrame) -> None:
    kept = np.arange(len(frame)) % 3 == 0
    cut = only_points(frame, kept)
    np.testing.assert_array_equal(cut.intensity, frame.intensity[kept])
    np.testing.assert_array_equal(cut.offset_ns, frame.offset_ns[kept])
    np.testing.assert_array_equal(cut.world_from_sensor, frame.world_from_sensor)
