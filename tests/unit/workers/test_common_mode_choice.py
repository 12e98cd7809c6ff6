import numpy as np
import pytest

from workers.lab.simulation.faults.candidates import candidates_of, measure_visibility
from workers.lab.simulation.faults.fault_placement import place_failures
from workers.lab.simulation.faults.plan import FailureKind, LogPlan, PlannedFailure
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar, SimulatedFrame, sweep
from workers.lab.simulation.world.street import Street
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.street_plan import StreetPlan

LIDAR = Lidar(elevation_deg=UNEVEN_64[::2], columns=512)


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(6, seconds=4.0, plan=StreetPlan(unsettling=True))


@pytest.fixture(scope="module")
def frames(street: Street) -> list[SimulatedFrame]:
    return [sweep(street, LIDAR, index) for index in range(40)]


def test_a_common_mode_failure_takes_the_slowest_of_what_both_streams_may_miss(
    street: Street, frames: list[SimulatedFrame]
) -> None:
    wanted = PlannedFailure(1, FailureKind.MISSED_MOVER, common_mode=True)
    plan = LogPlan(0, 11, 2, hard=False, software_version="2026.1", failures=(wanted,))
    (failure,), _ = place_failures(street, plan, frame_at=lambda index: frames[index], period_s=0.1)

    view = measure_visibility(
        street, lambda index: frames[index], from_s=2.0, to_s=4.0, period_s=0.1
    )
    able = candidates_of(view, FailureKind.MISSED_MOVER, common_mode=True)
    tracks = [each.track for each in able if each.lasts_s >= 0.6]
    speed = np.hypot(*street.actor_velocities(3.0).T)
    assert failure.common_mode
    assert failure.because
    assert len(tracks) > 1
    assert speed[failure.track] == pytest.approx(speed[tracks].min(), abs=0.02)
    assert speed[failure.track] > 0.5  # else truth would not call it a mover
