"""Priorities and quotas of vehicles, on any database."""

from collections.abc import Iterator, Sequence

import pytest
from sqlalchemy import select

from schemas.work import MineLease, NothingToDo, PlanLease
from service.curation.priorities import Priorities
from service.store.ledger import LeasePolicy, Ledger
from service.store.remining import ReminingPolicy
from service.store.tables import LEASES, SHARDS
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, plan_of
from tests.contracts.store_contract import StoreContract


class Ordered(World):
    """A world whose logs have three shards; their vehicle is the first folder."""

    def ordered(self, *priorities: str, plan_ahead: int = 1) -> None:
        """Restart the service with these priorities."""
        policy = ReminingPolicy(priorities=Priorities.parse(priorities))
        leases = LeasePolicy(plan_ahead=plan_ahead)
        self.ledger = Ledger(self.store, now_s=self.clock, policy=leases, remine=policy)

    def claimed(self, number: int) -> list[str]:
        """Claim shards that stay leased, and plan what comes between; gives their logs."""
        logs: list[str] = []
        while len(logs) < number:
            grant = self.claim()
            if isinstance(grant, NothingToDo):
                return logs
            if isinstance(grant, PlanLease):
                self.planned(grant)
                continue
            logs.append(grant.shard.log_id)
        return logs

    def planned(self, lease: PlanLease, vehicle: str = "") -> None:
        log_id = lease.recording.log_id
        name = vehicle or log_id.partition("/")[0]
        plan = plan_of(log_id).model_copy(update={"vehicle": name})
        assert self.commit_plan(lease, plan=plan).ok

    def lanes_held(self) -> list[int]:
        with self.store.reading() as connection:
            held = select(LEASES.c.lane).where(LEASES.c.is_held).order_by(LEASES.c.lane)
            return list(connection.execute(held).scalars())


def distinct(logs: Sequence[str]) -> list[str]:
    return list(dict.fromkeys(logs))


class PrioritiesContract(StoreContract):
    """Every promise, tested on what `make_store` opens."""

    @pytest.fixture
    def fleet(self) -> Iterator[Ordered]:
        store = self.make_store()
        fleet = Ordered.on(store)
        assert isinstance(fleet, Ordered)
        yield fleet
        store.close()

    def test_logs_are_mined_in_the_order_of_the_patterns(self, fleet: Ordered) -> None:
        fleet.ordered("car-3", "car-2/*")
        fleet.listed("car-1/a", "car-2/a", "car-3/a")
        assert distinct(fleet.claimed(9)) == ["car-3/a", "car-2/a", "car-1/a"]

    def test_others_may_come_before_the_last(self, fleet: Ordered) -> None:
        fleet.ordered("car-3", "others", "car-1")
        fleet.listed("car-1/a", "car-2/a", "car-3/a")
        assert distinct(fleet.claimed(9)) == ["car-3/a", "car-2/a", "car-1/a"]

    def test_a_vehicle_that_only_the_plan_knows_comes_first_once_it_is_planned(
        self, fleet: Ordered
    ) -> None:
        fleet.ordered("bus-*", plan_ahead=16)
        fleet.listed("a", "b", "c")
        for vehicle in ("car-1", "car-2", "bus-7"):
            fleet.planned(fleet.plan_lease(), vehicle)
        assert fleet.claimed(4) == ["c", "c", "c", "a"]

    def test_a_new_log_of_a_priority_is_planned_before_other_shards_are_mined(
        self, fleet: Ordered
    ) -> None:
        fleet.ordered("car-9")
        fleet.listed("car-1/a", "car-2/a")
        assert fleet.claimed(1) == ["car-1/a"]
        fleet.listed("car-1/a", "car-2/a", "car-9/a")
        assert fleet.claimed(4) == ["car-9/a", "car-9/a", "car-9/a", "car-1/a"]

    def test_other_priorities_after_a_restart_order_what_waits(self, fleet: Ordered) -> None:
        fleet.ordered("car-1", plan_ahead=16)
        fleet.listed("car-1/a", "car-2/a", "car-3/a")
        assert fleet.claimed(1) == ["car-1/a"]
        fleet.ordered("car-3", "car-2")
        assert fleet.claimed(6) == ["car-3/a"] * 3 + ["car-2/a"] * 3
        fleet.ordered()
        assert fleet.claimed(9) == ["car-1/a"] * 2
        with fleet.store.reading() as connection:
            waits = select(SHARDS.c.turn).where(SHARDS.c.state == "ready")
            assert set(connection.execute(waits).scalars()) <= {0}

    def test_a_vehicle_holds_no_more_leases_than_its_quota(self, fleet: Ordered) -> None:
        fleet.ordered("car-1=2", plan_ahead=16)
        fleet.listed("car-1/a", "car-1/b", "car-2/a")
        logs = fleet.claimed(9)
        assert len(logs) == 5
        assert distinct(logs) == ["car-1/a", "car-2/a"]
        assert logs.count("car-2/a") == 3
        assert isinstance(fleet.claim(), NothingToDo)

    def test_a_finished_lease_makes_room_in_the_quota(self, fleet: Ordered) -> None:
        fleet.ordered("car-1=1")
        fleet.listed("car-1/a")
        fleet.planned(fleet.plan_lease())
        lease = fleet.mine_lease()
        assert isinstance(fleet.claim("w2"), NothingToDo)
        assert fleet.commit_shard(lease).ok
        assert isinstance(fleet.claim("w2"), MineLease)

    def test_a_share_holds_while_other_work_waits_and_leaves_no_worker_idle(
        self, fleet: Ordered
    ) -> None:
        fleet.ordered("car-1=25%", plan_ahead=64)
        fleet.listed(*(f"car-{car}/{log}" for car in (1, 2) for log in "abcd"))
        logs = [log.partition("/")[0] for log in fleet.claimed(16)]
        assert logs.count("car-1") == 4
        assert logs.count("car-2") == 12
        assert fleet.claimed(20) == ["car-1/b", "car-1/b"] + ["car-1/c"] * 3 + ["car-1/d"] * 3

    def test_a_held_lease_counts_in_the_lane_of_other_priorities(self, fleet: Ordered) -> None:
        fleet.ordered()
        fleet.listed("car-1/a", "car-1/b")
        fleet.planned(fleet.plan_lease())
        assert fleet.claimed(1) == ["car-1/a"]
        assert fleet.lanes_held() == [63]
        fleet.ordered("car-9", "car-1=1")
        assert isinstance(fleet.claim("w2"), NothingToDo)
        assert fleet.lanes_held() == [1]


class TestPrioritiesOnSqlite(OnSqlite, PrioritiesContract):
    """A file."""


class TestPrioritiesOnPostgres(OnPostgres, PrioritiesContract):
    """A real server."""
