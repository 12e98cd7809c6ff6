from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.factories import SMALL_LIDAR
from workers.lab.simulation.faults.candidates import SceneVisibility, measure_visibility
from workers.lab.simulation.faults.fault_placement import place_failures
from workers.lab.simulation.faults.fault_truth import PlantedTruth
from workers.lab.simulation.faults.faults import DYNAMIC, STATIC, PlantedFailure
from workers.lab.simulation.faults.plan import (
    DRAWN_KINDS,
    LIFELIKE_KINDS,
    FailureKind,
    LogPlan,
    PlannedFailure,
    plan_fleet,
)
from workers.lab.simulation.faults.recorded import noise_of, record
from workers.lab.simulation.faults.structure_ghosts import structure_ghosts
from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.output.fleet import FleetOptions, planned_street, simulate_to
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar, SimulatedFrame, sweep
from workers.lab.simulation.world.motion_along_road import Road, drive_along, stand
from workers.lab.simulation.world.street import Actor, Street
from workers.lab.simulation.world.street_builder import build_street

LIDAR = Lidar(elevation_deg=UNEVEN_64[::2], columns=512)


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(4, seconds=6.0, style="drives")


@pytest.fixture(scope="module")
def frames(street: Street) -> list[SimulatedFrame]:
    return [sweep(street, LIDAR, index) for index in range(40)]


@pytest.fixture(scope="module")
def view(street: Street, frames: list[SimulatedFrame]) -> SceneVisibility:
    return measure_visibility(
        street, lambda index: frames[index], from_s=1.2, to_s=4.0, period_s=0.1
    )


def _lorry_street() -> Street:
    """A lorry that drives past a car that stands."""
    road = Road.bending(from_m=-60.0, to_m=120.0, swing_rad=0.0, wave_m=300.0)
    drive = drive_along(
        road,
        from_m=4.0,
        across_m=6.0,
        speed=[(0.0, 3.0), (9.0, 3.0)],
        seconds=8.0,
        backwards=False,
    )
    return Street.of(
        seed=3,
        seconds=8.0,
        ego=stand(road, at_m=0.0, across_m=0.0),
        actors=[Actor(StreetClass.BUS, drive)],
        fixed=[],
        even=True,
    )


def test_lifelike_logs_have_drawn_lengths_and_begin_in_the_middle_of_the_drive() -> None:
    logs = plan_fleet(scenes=200, seed=9, share=0.3, lifelike=True)
    assert sum(log.scenes for log in logs) == 200
    assert {log.scenes for log in logs[:-1]} == set(range(2, 9))
    assert all(log.lifelike and log.begin_s >= 2.0 for log in logs)
    kinds = Counter(e.kind for log in logs for e in log.failures if not e.common_mode)
    assert set(kinds) == set(LIFELIKE_KINDS)
    assert max(kinds.values()) - min(kinds.values()) <= 1
    for log in logs:
        assert all(0 <= each.cell < log.scenes for each in log.failures)
        assert all(0 <= each.cell < log.scenes for each in log.disturbances)


def test_a_fleet_without_options_has_neither_new_kinds_nor_new_lengths() -> None:
    logs = plan_fleet(scenes=200, seed=9, share=0.3)
    assert {log.scenes for log in logs} == {10}
    assert not any(log.lifelike or log.begin_s for log in logs)
    assert all(log.kinds == DRAWN_KINDS for log in logs)


def test_lengths_of_logs_can_be_chosen() -> None:
    logs = plan_fleet(scenes=50, seed=1, share=0.1, log_s=(6.0, 8.0))
    assert {log.scenes for log in logs[:-1]} == {3, 4}
    with pytest.raises(ValueError, match="a log lasts 2"):
        plan_fleet(scenes=50, seed=1, share=0.1, log_s=(1.0, 8.0))


def test_a_street_some_seconds_later_is_the_same_street(street: Street) -> None:
    later = street.after(2.0)
    assert later.seconds == 4.0
    for time_s in (0.0, 1.3, 3.9):
        np.testing.assert_allclose(
            later.actor_poses(time_s), street.actor_poses(time_s + 2.0), atol=1e-9
        )
        np.testing.assert_allclose(later.ego.pose(time_s), street.ego.pose(time_s + 2.0))
        np.testing.assert_allclose(
            later.ego_bodies(np.array([time_s])), street.ego_bodies(np.array([time_s + 2.0]))
        )
    speed = np.hypot(*later.actor_velocities(0.0).T)
    assert (speed > 1.0).any()  # movers from the first frame on


def test_a_lifelike_log_lasts_as_long_as_planned() -> None:
    plan = LogPlan(0, 5, 3, hard=False, software_version="2026.1", lifelike=True, begin_s=3.47)
    assert planned_street(plan).seconds == 6.0


def test_ghosts_stick_to_points_that_stand(
    street: Street, frames: list[SimulatedFrame], view: SceneVisibility
) -> None:
    ghosts = list(structure_ghosts(view))
    assert any(any(each.slides_m_per_s) for each in ghosts)
    assert any(each.track >= 0 for each in ghosts)
    for each in ghosts:
        failure = PlantedFailure(
            FailureKind.GHOST_MOVER,
            each.track,
            each.start_s,
            each.start_s + each.lasts_s - 1e-6,
            place_m=each.place_m,
            radius_m=each.radius_m,
            slides_m_per_s=each.slides_m_per_s,
        )
        for frame in (frames[seen.index] for seen in view.frames):
            wrong = record(street, frame, [failure]).motion != frame.motion
            assert bool(wrong.any()) == failure.is_on(frame.time_s)
            if not wrong.any():
                continue
            assert wrong.sum() >= 25
            assert (frame.motion[wrong] == STATIC).all()
            assert (frame.ground[wrong] == 0).all()
            assert set(frame.track[wrong]) <= {-1, each.track}
            if each.track >= 0:  # most of a parked vehicle: truth counts it as failing
                assert wrong[frame.track == each.track].mean() > 0.5


def test_a_sliding_ghost_goes_along_its_wall(view: SceneVisibility) -> None:
    sliding = next(each for each in structure_ghosts(view) if any(each.slides_m_per_s))
    failure = PlantedFailure(
        FailureKind.GHOST_MOVER,
        -1,
        1.0,
        3.0,
        place_m=sliding.place_m,
        slides_m_per_s=sliding.slides_m_per_s,
    )
    went = failure.ghost_place_m(2.5) - failure.ghost_place_m(1.5)
    np.testing.assert_allclose(went, [*sliding.slides_m_per_s, 0.0], atol=1e-9)


def test_a_half_labelled_lorry_has_one_part_wrong_that_is_its_greater_one() -> None:
    street = _lorry_street()
    frames = [sweep(street, LIDAR, index) for index in range(40)]
    wanted = PlannedFailure(1, FailureKind.HALF_LABELLED)
    plan = LogPlan(
        0, 11, 2, hard=False, software_version="2026.1", failures=(wanted,), lifelike=True
    )
    (failure,), redraws = place_failures(
        street, plan, frame_at=lambda index: frames[index], period_s=0.1
    )
    assert failure.kind is FailureKind.HALF_LABELLED
    assert not redraws
    assert failure.end_s - failure.start_s >= 1.0
    for frame in frames:
        wrong = record(street, frame, [failure]).motion != frame.motion
        assert bool(wrong.any()) == failure.is_on(frame.time_s)
        if wrong.any():
            mine = frame.track == 0
            assert 0.5 < wrong[mine].mean() < 0.9
            assert not wrong[~mine].any()
            part, rest = frame.points_m[wrong, 0], frame.points_m[mine & ~wrong, 0]
            assert part.max() <= rest.min() + 0.02 or part.min() >= rest.max() - 0.02


def test_half_of_the_first_failures_begin_with_the_log(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    begins = []
    for seed in range(12):
        wanted = PlannedFailure(0, FailureKind.PARKED_CALLED_MOVING)
        plan = LogPlan(
            0, seed, 2, hard=False, software_version="2026.1", failures=(wanted,), lifelike=True
        )
        failures, _ = place_failures(
            street, plan, frame_at=lambda index: frames[index], period_s=0.1
        )
        begins += [each.start_s for each in failures]
    assert 0.0 in begins
    assert any(start_s >= 1.2 for start_s in begins)


def test_noise_bleeds_over_borders_and_is_less_sure_there(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    noise = noise_of(street)
    clean_sure, noisy_sure, wrong_share = [], [], []
    for frame in frames[:20]:
        clean = record(street, frame, [])
        assert (clean.motion == frame.motion).all()
        noisy = record(street, frame, [], noise=noise)
        wrong = noisy.motion != frame.motion
        clean_sure.append(float(noisy.confidence[~wrong].mean()))
        noisy_sure.append(float(noisy.confidence[wrong].mean()))
        wrong_share.append(wrong.sum() / max((frame.motion == DYNAMIC).sum(), 1))
    assert 0.01 < np.mean(wrong_share) < 0.5
    assert np.mean(noisy_sure) < np.mean(clean_sure) - 0.04


def test_a_lifelike_fleet_depends_on_its_seed_alone_and_says_what_it_is(tmp_path: Path) -> None:
    plans = plan_fleet(scenes=2, seed=3, share=0.5, lifelike=True)
    first, again = (
        next(simulate_to(str(tmp_path / name), plans, options=FleetOptions(lidar=SMALL_LIDAR)))
        for name in ("a", "b")
    )
    assert first.log.read_bytes() == again.log.read_bytes()
    truth = PlantedTruth.beside(first.truth)
    assert truth is not None
    assert truth.lifelike
