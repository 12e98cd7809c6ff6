"""What is counted over a ledger, on any database: rates, what waits, and what became true."""

from collections.abc import Mapping
from typing import Any

import pytest

from schemas.arrays import NS_PER_S
from schemas.canonical import sha256
from schemas.contradiction import SceneState
from schemas.score import AgreementShares, SceneScore
from schemas.transport.wire import encode_scene_score
from schemas.work import Damage, FailRequest, LogPlan, MineLease, PlanLease
from service.curation.rates import RateRow, RatesBy, RatesRequest, rates
from service.store.backlog import LogDamage
from service.store.ledger import Ledger
from service.store.transaction_effects import Effects
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import (
    START_NS,
    World,
    mined,
    plan_of,
    recording,
    score_of,
    shard_commit,
)
from tests.contracts.store_contract import StoreContract

HOUR_NS = 3600 * NS_PER_S


class Noted:
    """Keeps what the store tells."""

    def __init__(self) -> None:
        self.effects: list[Effects] = []
        self.database_errors = self.damaged_records = 0

    def on_effects(self, effects: Effects) -> None:
        self.effects.append(effects)

    def on_database_error(self) -> None:
        self.database_errors += 1

    def on_damaged_record(self) -> None:
        self.damaged_records += 1

    def leases_ended(self) -> dict[str, int]:
        return {
            reason: sum(effects.leases_ended[reason] for effects in self.effects)
            for reason in sorted({reason for one in self.effects for reason in one.leases_ended})
        }

    def commits(self) -> list[tuple[str, str]]:
        return [answer for effects in self.effects for answer in effects.commits.elements()]

    def scene_ids(self) -> list[str]:
        return [score.scene_id for effects in self.effects for score in effects.scenes]


def store_scenes(world: World, *scores: SceneScore) -> None:
    """Commit these scenes, one shard for each log, in a bucket of just these logs."""
    logs = sorted({score.log_id for score in scores})
    world.listed(*logs)
    for _ in logs:
        lease = world.plan_lease()
        log_id = lease.recording.log_id
        assert world.commit_plan(lease, plan=plan_of(log_id, shards=1, cells=36_000)).ok
    for _ in logs:
        mine = world.mine_lease()
        encoded = [
            encode_scene_score(score) for score in scores if score.log_id == mine.shard.log_id
        ]
        records = {sha256(record): record for record in encoded}
        assert world.ledger.commit(shard_commit(mine, records), records).ok


def scene(
    log_id: str,
    *,
    at_s: float = 0,
    vehicle: str = "bus-7",
    version: str = "2.4",
    semantic: float = 0.0,
    predictive: float = 0.0,
    score: float = 0.0,
    state: SceneState = SceneState.SCORED,
) -> SceneScore:
    shares = AgreementShares(
        both_static=round(1 - semantic - predictive, 6),
        both_dynamic=0,
        only_semantic_dynamic=semantic,
        only_predictive_dynamic=predictive,
    )
    start_ns = START_NS + round(at_s * NS_PER_S)
    changed = {"vehicle": vehicle, "software_version": version, "all_points": shares}
    return score_of(log_id, start_ns, score=score, state=state).model_copy(update=changed)


def rates_of(ledger: Ledger, by: RatesBy, **asked: int) -> list[RateRow]:
    return rates(ledger.rate_sums(RatesRequest(by=by, **asked)), by)


class CountsContract(StoreContract):
    # Rates. Every scene has 1000 points, 800 of them compared, and 20 frames.

    def test_rates_are_shares_of_the_compared_points_of_each_vehicle_worst_first(
        self, world: World
    ) -> None:
        store_scenes(
            world,
            scene("a", vehicle="car-1", semantic=0.01, score=0.5),
            scene("a", at_s=2, vehicle="car-1", predictive=0.03, score=0.25),
            scene("b", vehicle="car-2", semantic=0.1, score=0.9, state=SceneState.SCORED),
            scene("b", at_s=2, vehicle="car-2", state=SceneState.ODOMETRY_LOST),
        )
        assert rates_of(world.ledger, "vehicle") == [
            RateRow(
                group="car-2",
                scenes=2,
                frames=40,
                compared_points=1600,
                contradicting_points=80,
                disagreement_rate=0.05,
                only_semantic_dynamic_rate=0.05,
                only_predictive_dynamic_rate=0.0,
                scenes_with_contradictions=1,
                gated_scenes=1,
                mean_score=0.9,
                best_score=0.9,
            ),
            RateRow(
                group="car-1",
                scenes=2,
                frames=40,
                compared_points=1600,
                contradicting_points=32,
                disagreement_rate=0.02,
                only_semantic_dynamic_rate=0.005,
                only_predictive_dynamic_rate=0.015,
                scenes_with_contradictions=2,
                gated_scenes=0,
                mean_score=0.375,
                best_score=0.5,
            ),
        ]

    def test_rates_by_hour_are_in_the_order_of_recording(self, world: World) -> None:
        store_scenes(
            world,
            scene("a", semantic=0.1),
            scene("a", at_s=3600, semantic=0.2),
            scene("a", at_s=3602, semantic=0.4),
        )
        first, second = rates_of(world.ledger, "hour")
        assert (first.time, second.time) == ("2023-11-14T22:00:00Z", "2023-11-14T23:00:00Z")
        assert second.time_ms == 1_700_002_800_000
        assert (first.scenes, second.scenes) == (1, 2)
        assert second.disagreement_rate == pytest.approx(0.3)

    def test_rates_by_version_and_by_log_group_by_those(self, world: World) -> None:
        store_scenes(
            world,
            scene("a", version="2.4", semantic=0.1),
            scene("b", version="2.5", semantic=0.2),
            scene("c", version="2.5"),
        )
        assert [row.group for row in rates_of(world.ledger, "version")] == ["2.4", "2.5"]
        assert [row.group for row in rates_of(world.ledger, "log")] == ["b", "a", "c"]

    def test_rates_by_kind_tell_the_two_kinds_of_contradiction_apart(self, world: World) -> None:
        store_scenes(
            world,
            scene("a", semantic=0.1),
            scene("a", at_s=2, semantic=0.1, predictive=0.05),
            scene("a", at_s=4),
        )
        semantic, predictive = rates_of(world.ledger, "kind")
        assert (semantic.group, predictive.group) == (
            "only_semantic_dynamic",
            "only_predictive_dynamic",
        )
        assert (semantic.contradicting_points, predictive.contradicting_points) == (160, 40)
        assert semantic.disagreement_rate == pytest.approx(160 / 2400, abs=1e-6)
        assert (semantic.scenes, semantic.scenes_with_contradictions) == (3, 2)
        assert predictive.scenes_with_contradictions == 1

    def test_rates_count_what_was_recorded_from_since_on_and_before_until(
        self, world: World
    ) -> None:
        store_scenes(world, *(scene("a", at_s=second) for second in (0, 2, 4)))
        second, third = START_NS + 2 * NS_PER_S, START_NS + 4 * NS_PER_S

        def scenes(**asked: int) -> list[int]:
            return [row.scenes for row in rates_of(world.ledger, "log", **asked)]

        assert scenes(since_ns=second) == [2]
        assert scenes(until_ns=third) == [2]
        assert scenes(since_ns=second, until_ns=third) == [1]
        assert scenes(since_ns=third + 1) == []

    def test_rates_over_nothing_are_no_rows(self, world: World) -> None:
        for by in ("vehicle", "version", "kind", "hour", "log"):
            assert rates_of(world.ledger, by) == []

    def test_a_withdrawn_scene_counts_no_more(self, world: World) -> None:
        store_scenes(world, scene("a", semantic=0.1), scene("b"))
        world.listed("b")
        assert [row.group for row in rates_of(world.ledger, "log")] == ["b"]

    # What waits.

    def test_the_backlog_agrees_with_the_status_at_every_step(self, world: World) -> None:
        world.listed("a", "b", "c")

        def agree() -> None:
            backlog, status = world.ledger.backlog(), world.ledger.status()
            shards = {state: n for (work, state), n in backlog.work.items() if work == "shard"}
            assert {state: n for state, n in shards.items() if n} == status.shards_by_state
            recordings = {state: n for state, n in backlog.recordings.items() if n}
            assert recordings == status.logs_by_state
            assert backlog.current_scenes == status.scenes
            assert backlog.unpublished == status.last_seq - status.published_seq

        agree()
        assert world.commit_plan(world.plan_lease(), plan=plan_of("a", refused="no lidar")).ok
        agree()
        assert world.commit_plan(world.plan_lease()).ok
        agree()
        parked = world.plan_lease()
        agree()
        assert world.fail(parked, permanent=True).ok
        agree()
        held = world.mine_lease()
        agree()
        assert world.ledger.backlog().leases_held == 1
        assert world.ledger.backlog().workers == 1
        assert world.commit_shard(held).ok
        agree()
        assert world.fail(world.mine_lease(), replaced=True).ok
        agree()
        world.mine_all()
        agree()
        world.ledger.mark_published(2)
        agree()

    def test_logs_that_are_mined_only_in_part_are_counted_once_for_as_long_as_they_are_there(
        self, world: World
    ) -> None:
        def plan(log_id: str, **found: Any) -> LogPlan:
            return plan_of(log_id, shards=1).model_copy(update={"damage": ()} | found)

        def damaged() -> Mapping[LogDamage, int]:
            return world.ledger.backlog().damaged

        scratch = Damage(key="x.mcap", offset=4, bytes=8, what="CRC differs")
        notice = Damage(key="x.mcap", offset=0, bytes=0, what="no box has a class")
        plans = {
            "cut": plan("cut", truncated_parts=2, damage=(scratch,)),
            "refused": plan("refused", truncated_parts=1, shards=(), refused="no lidar"),
            "noticed": plan("noticed", damage=(notice, notice)),
            "scratched": plan("scratched", damage=(scratch, scratch, notice)),
            "torn": plan("torn"),
            "whole": plan("whole"),
        }
        world.planner = lambda recording: plans[recording.log_id]
        world.listed(*plans)
        assert damaged() == {"truncated": 0, "unreadable": 0}
        assert world.ledger.backlog().noticed == 0
        world.plan_all()
        assert damaged() == {"truncated": 1, "unreadable": 1}
        assert world.ledger.backlog().noticed == 2
        while isinstance(lease := world.claim(), MineLease):
            found = (scratch,) if lease.shard.log_id == "torn" else ()
            records = mined(lease.shard)
            request = shard_commit(lease, records).model_copy(update={"damage": found})
            assert world.ledger.commit(request, records).ok
        assert damaged() == {"truncated": 1, "unreadable": 2}
        assert [log.truncated_parts for log in world.ledger.status().logs] == [2, 0, 1, 0, 0, 0]
        plans["cut"] = plan("cut")  # the whole object has arrived
        rest = [recording(log_id) for log_id in ("torn", "whole")]
        world.ledger.sync_recordings([recording("cut", etag="whole"), *rest])
        assert damaged() == {"truncated": 0, "unreadable": 1}
        world.mine_all()
        assert damaged() == {"truncated": 0, "unreadable": 1}
        world.register_pipeline("p2")
        assert damaged() == {"truncated": 0, "unreadable": 0}

    def test_the_oldest_recording_with_work_left_gives_the_age(self, world: World) -> None:
        assert world.ledger.backlog().oldest_listed_s is None
        world.listed("a")
        first_s = world.clock.now_s
        assert world.ledger.backlog().oldest_listed_s == first_s
        world.clock.now_s += 100
        world.listed("a", "b")
        lease = world.plan_lease()
        assert lease.recording.log_id == "a"
        assert world.commit_plan(lease, plan=plan_of("a", shards=1)).ok
        assert world.ledger.backlog().oldest_listed_s == first_s
        world.clock.now_s += 10_000
        assert world.commit_plan(world.plan_lease(), plan=plan_of("b", shards=1)).ok
        assert world.commit_shard(world.mine_lease()).ok
        assert world.ledger.backlog().oldest_listed_s == first_s + 100
        assert world.commit_shard(world.mine_lease()).ok
        assert world.ledger.backlog().oldest_listed_s is None

    def test_parked_work_of_a_recording_that_is_gone_counts_no_more(self, world: World) -> None:
        world.listed("a")
        assert world.fail(world.plan_lease(), permanent=True).ok
        assert world.ledger.backlog().work["plan", "parked"] == 1
        world.listed("b")
        assert world.ledger.backlog().work["plan", "parked"] == 0

    # What became true.

    def test_scenes_are_told_once_however_often_their_commit_comes(self, world: World) -> None:
        noted = Noted()
        world.ledger.observe(noted)
        world.listed("a")
        assert world.commit_plan(world.plan_lease(), plan=plan_of("a", shards=1)).ok
        lease = world.mine_lease()
        for _ in range(3):
            assert world.commit_shard(lease).ok
        assert sorted(noted.scene_ids()) == sorted(world.ids())
        assert noted.commits() == [
            ("plan", "stored"),
            ("shard", "stored"),
            ("shard", "repeated"),
            ("shard", "repeated"),
        ]

    def test_a_commit_that_is_not_taken_tells_no_scene(self, world: World) -> None:
        noted = Noted()
        world.listed("a")
        assert world.commit_plan(world.plan_lease(), plan=plan_of("a", shards=1)).ok
        lease = world.mine_lease()
        world.ledger.observe(noted)
        record = encode_scene_score(scene("a"))
        request = shard_commit(lease, {sha256(record): record})
        assert world.ledger.commit(request, {}).missing
        world.listed("b")
        assert not world.ledger.commit(request, {sha256(record): record}).ok
        assert noted.commits() == [("shard", "missing"), ("shard", "refused")]
        assert noted.scene_ids() == []

    def test_every_end_of_a_lease_is_told_with_its_reason(self, world: World) -> None:
        noted = Noted()
        world.ledger.observe(noted)
        world.listed("a")

        def lease() -> PlanLease | MineLease:
            world.clock.now_s += 100
            grant = world.claim()
            assert isinstance(grant, PlanLease | MineLease)
            return grant

        def told(reason: str) -> None:
            assert noted.leases_ended() == {reason: 1}
            noted.effects.clear()

        assert world.fail(lease()).ok
        told("failed")
        assert world.fail(lease(), given_back=True).ok
        told("given back")
        lease()
        world.ledger.worker_died("w1")
        told("worker died")
        lease()
        world.ledger.free_leases("w")
        told("freed")
        lease()
        world.clock.now_s += 100
        world.ledger.expire()
        told("expired")
        growing = lease()
        assert world.ledger.fail(
            FailRequest(
                worker_id="w1",
                lease_id=growing.lease_id,
                error="no footer",
                permanent=False,
                growing=True,
            )
        ).ok
        told("growing")
        lease()
        world.listed("b")
        told("replaced")
        planned = lease()
        assert isinstance(planned, PlanLease)
        assert world.commit_plan(planned).ok
        told("committed")

    def test_parking_is_told_by_kind_of_work(self, world: World) -> None:
        noted = Noted()
        world.ledger.observe(noted)
        world.listed("a", "b")
        assert world.fail(world.plan_lease(), permanent=True).ok
        assert world.commit_plan(world.plan_lease()).ok
        assert world.fail(world.mine_lease(), permanent=True).ok
        parked = sum((effects.parked for effects in noted.effects), start=Effects().parked)
        assert parked == {"plan": 1, "shard": 1}

    def test_a_transaction_that_was_undone_tells_nothing(self, world: World) -> None:
        noted = Noted()
        world.listed("a")
        assert world.commit_plan(world.plan_lease(), plan=plan_of("a", shards=1)).ok
        lease = world.mine_lease()
        world.ledger.observe(noted)
        good, stranger = encode_scene_score(scene("a")), encode_scene_score(scene("x"))
        records = {sha256(record): record for record in (good, stranger)}
        assert world.ledger.commit(shard_commit(lease, records), records).problem
        assert noted.scene_ids() == []


class TestCountsOnSqlite(OnSqlite, CountsContract):
    pass


@pytest.mark.integration
class TestCountsOnPostgres(OnPostgres, CountsContract):
    pass
