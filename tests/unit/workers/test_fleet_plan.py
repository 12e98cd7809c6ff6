from collections import Counter

import pytest

from workers.lab.simulation.faults.plan import (
    DRAWN_KINDS,
    REGRESSED_VERSION,
    DisturbanceKind,
    FailureKind,
    plan_fleet,
)


def test_a_fleet_holds_exactly_the_shares_that_were_asked_for() -> None:
    logs = plan_fleet(scenes=600, seed=1, share=0.05)
    assert sum(log.scenes for log in logs) == 600
    failures = [each for log in logs for each in log.failures]
    assert len(failures) == 30
    assert sum(each.common_mode for each in failures) == 6
    assert sum(len(log.disturbances) for log in logs) == 120
    assert sum(log.hard for log in logs) == 24
    assert all(each.kind is FailureKind.MISSED_MOVER for each in failures if each.common_mode)


def test_all_kinds_are_equally_likely() -> None:
    logs = plan_fleet(scenes=3000, seed=2, share=0.3)
    kinds = Counter(each.kind for log in logs for each in log.failures if not each.common_mode)
    assert set(kinds) == set(DRAWN_KINDS)
    assert max(kinds.values()) - min(kinds.values()) <= 1
    disturbances = Counter(each.kind for log in logs for each in log.disturbances)
    assert set(disturbances) == set(DisturbanceKind)
    assert max(disturbances.values()) - min(disturbances.values()) <= 1


def test_a_regression_happens_only_to_the_version_that_regressed() -> None:
    logs = plan_fleet(scenes=600, seed=3, share=0.5)
    regressed = [
        log.software_version
        for log in logs
        for each in log.failures
        if each.kind is FailureKind.VERSION_REGRESSION
    ]
    assert set(regressed) == {REGRESSED_VERSION}


def test_failures_disturbances_and_hard_logs_are_independent() -> None:
    both = failing = disturbed = hard = 0
    for seed in range(20):
        for log in plan_fleet(scenes=600, seed=seed, share=0.2):
            cells = {each.cell for each in log.failures}
            both += len(cells & {each.cell for each in log.disturbances})
            failing += len(cells)
            disturbed += len(log.disturbances)
            hard += len(cells) * log.hard
    assert both / failing == pytest.approx(0.2, abs=0.03)
    assert both / disturbed == pytest.approx(0.2, abs=0.03)
    assert hard / failing == pytest.approx(0.4, abs=0.03)


def test_a_plan_depends_on_its_seed_alone() -> None:
    assert plan_fleet(scenes=40, seed=4, share=0.2) == plan_fleet(scenes=40, seed=4, share=0.2)
    assert plan_fleet(scenes=40, seed=4, share=0.2) != plan_fleet(scenes=40, seed=5, share=0.2)


def test_the_last_log_may_be_shorter() -> None:
    assert [log.scenes for log in plan_fleet(scenes=25, seed=1, share=0.1)] == [10, 10, 5]


@pytest.mark.parametrize(("scenes", "share"), [(0, 0.1), (10, 1.5), (10, -0.1)])
def test_an_impossible_fleet_is_refused(scenes: int, share: float) -> None:
    with pytest.raises(ValueError, match="shares of 0 to 1"):
        plan_fleet(scenes=scenes, seed=1, share=share)
