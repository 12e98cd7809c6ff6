import numpy as np
import pytest

from tests.factories import SMALL_LIDAR
from workers.lab.simulation.faults.confidence import draw_confidence, quantiles
from workers.lab.simulation.faults.fault_placement import Redraw, place_failures
from workers.lab.simulation.faults.faults import DYNAMIC, STATIC, PlantedFailure
from workers.lab.simulation.faults.plan import (
    DRAWN_KINDS,
    SCENE_S,
    FailureKind,
    LogPlan,
    PlannedFailure,
)
from workers.lab.simulation.faults.recorded import record
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar, SimulatedFrame, sweep
from workers.lab.simulation.world.street import Street
from workers.lab.simulation.world.street_builder import build_street

LIDAR = Lidar(elevation_deg=UNEVEN_64[::2], columns=512)


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(4, seconds=8.0, style="drives")


@pytest.fixture(scope="module")
def frames(street: Street) -> list[SimulatedFrame]:
    return [sweep(street, LIDAR, index) for index in range(80)]


def planted_in(
    street: Street, frames: list[SimulatedFrame], *wanted: PlannedFailure
) -> tuple[tuple[PlantedFailure, ...], tuple[Redraw, ...]]:
    plan = LogPlan(0, 11, 4, hard=False, software_version="2026.2", failures=wanted)
    return place_failures(street, plan, frame_at=lambda index: frames[index], period_s=0.1)


@pytest.mark.parametrize("kind", DRAWN_KINDS)
def test_a_planted_failure_is_wrong_for_half_a_second_on_25_points_or_was_drawn_anew(
    street: Street, frames: list[SimulatedFrame], kind: FailureKind
) -> None:
    (failure,), redraws = planted_in(street, frames, PlannedFailure(2, kind))
    assert failure.kind is kind or redraws[0].kind is failure.kind
    assert failure.cell * SCENE_S <= failure.start_s
    assert failure.end_s <= (failure.cell + 1) * SCENE_S
    wrong_frames = 0
    for frame in frames:
        said = record(street, frame, [failure])
        wrong = said.motion != frame.motion
        inside = failure.start_s <= frame.time_s < failure.end_s
        assert inside or not wrong.any()
        mine = wrong if failure.track < 0 else wrong & (frame.track == failure.track)
        wrong_frames += int(mine.sum() >= 25)
    assert wrong_frames >= 5


def test_a_missed_mover_is_called_static_and_a_parked_car_moving(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    (missed,), _ = planted_in(street, frames, PlannedFailure(1, FailureKind.MISSED_MOVER))
    (parked,), _ = planted_in(street, frames, PlannedFailure(1, FailureKind.PARKED_CALLED_MOVING))
    for failure, said_of_it in ((missed, STATIC), (parked, DYNAMIC)):
        frame = next(f for f in frames if f.time_s >= failure.start_s)
        said = record(street, frame, [failure])
        mine = frame.track == failure.track
        assert (said.motion[mine] == said_of_it).all()
        assert (frame.motion[mine] != said_of_it).all()


def test_a_swap_gives_each_of_two_things_the_label_of_the_other(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    (swap,), redraws = planted_in(street, frames, PlannedFailure(1, FailureKind.LABEL_SWAP))
    assert not redraws or redraws[0].kind is FailureKind.LABEL_SWAP
    frame = next(f for f in frames if f.time_s >= swap.start_s)
    said = record(street, frame, [swap])
    assert (said.motion[frame.track == swap.track] == STATIC).all()
    assert (said.motion[frame.track == swap.other_track] == DYNAMIC).all()
    assert (frame.motion[frame.track == swap.other_track] == STATIC).all()


def test_a_ghost_is_nobodys_and_stands(street: Street, frames: list[SimulatedFrame]) -> None:
    (ghost,), _ = planted_in(street, frames, PlannedFailure(2, FailureKind.GHOST_MOVER))
    assert ghost.track == -1
    frame = next(f for f in frames if f.time_s >= ghost.start_s)
    wrong = record(street, frame, [ghost]).motion != frame.motion
    assert wrong.sum() >= 25
    assert (frame.track[wrong] == -1).all()
    assert (frame.ground[wrong] == 0).all()


def test_what_no_thing_can_carry_is_drawn_anew_and_written_down() -> None:
    empty = build_street(4, seconds=4.0, style="stands")
    frames = [sweep(empty, SMALL_LIDAR, index) for index in range(40)]  # too few points on any
    wanted = PlannedFailure(1, FailureKind.UNSEEN_CLASS)
    plan = LogPlan(0, 11, 2, hard=False, software_version="2026.1", failures=(wanted,))
    failures, redraws = place_failures(
        empty, plan, frame_at=lambda index: frames[index], period_s=0.1
    )
    assert redraws[0].planned == wanted
    assert redraws[0].kind is (failures[0].kind if failures else None)


def test_planting_depends_on_the_seed_alone(street: Street, frames: list[SimulatedFrame]) -> None:
    wanted = PlannedFailure(2, FailureKind.FLICKER)
    assert planted_in(street, frames, wanted) == planted_in(street, frames, wanted)


def test_confidence_follows_the_measured_quantiles_and_lasts() -> None:
    right, wrong = quantiles()
    drawn = [
        draw_confidence(seed=1, things=2000, time_s=0.1 * index, index=index) for index in range(3)
    ]
    assert np.median(drawn[0][0]) == pytest.approx(np.median(right), abs=0.02)
    assert np.median(drawn[0][1]) == pytest.approx(np.median(wrong), abs=0.05)
    assert drawn[0][1].min() >= wrong.min()
    assert np.corrcoef(drawn[0][1], drawn[1][1])[0, 1] > 0.5
    again = draw_confidence(seed=1, things=2000, time_s=0.1, index=1)
    np.testing.assert_array_equal(again[0], drawn[1][0])
