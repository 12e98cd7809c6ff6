"""A new pipeline version on any database: scores computed again, logs mined again by priority."""

from collections.abc import Iterator
from typing import Any

import pytest
from sqlalchemy import select

from schemas.verdict import Verdict
from schemas.work import ClaimRequest, FailRequest, Layers, MineLease, NothingToDo, PlanLease
from service.curation.verdicts import JudgeRequest
from service.store.ledger import LeasePolicy, Ledger
from service.store.remining import Mode, ReminingPolicy
from service.store.tables import PLANS
from service.store.turns import Kind
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, mined, plan_of, shard_commit
from tests.contracts.store_contract import StoreContract

OLD = Layers(labels="l1", contradictions="c1", score="s1")
SCORED = Layers(labels="l1", contradictions="c1", score="s2")
STREAM = Layers(labels="l2", contradictions="c1", score="s1")
LAYERS = {"p1": OLD, "p2": SCORED, "q2": STREAM}


class Fleet(World):
    """A world whose workers state the layers of their version."""

    def claim(self, worker: str = "w1", version: str = "p1") -> Any:
        return self.ledger.claim(
            ClaimRequest(worker_id=worker, pipeline_version=version, layers=LAYERS[version])
        ).grant

    def restarted(
        self,
        mode: Mode = "newest",
        *,
        core_hours_a_day: float = 0.0,
        canary_share: float = 0.0,
    ) -> None:
        self.ledger = Ledger(
            self.store,
            now_s=self.clock,
            policy=LeasePolicy(),
            remine=ReminingPolicy(mode, core_hours_a_day, canary_share),
        )

    def work_of(self, version: str) -> list[tuple[str, str]]:
        """Plan and mine all; gives kind of lease and log in the order of claims."""
        done: list[tuple[str, str]] = []
        while not isinstance(grant := self.claim("w1", version), NothingToDo):
            if isinstance(grant, PlanLease):
                plan = plan_of(grant.recording.log_id, shards=1)
                assert self.commit_plan(grant, plan=plan).ok
                done.append(("plan", grant.recording.log_id))
                continue
            done.append(("rescore" if grant.rescore else "mine", grant.shard.log_id))
            records = mined(grant.shard, pipeline_version=version)
            commit = shard_commit(grant, records)
            stats = commit.stats.model_copy(update={"stage_s": {"supervised": 3600.0}})
            if grant.rescore:
                stats = stats.model_copy(update={"frames": 0, "points": 0, "stage_s": {}})
            commit = commit.model_copy(update={"stats": stats})
            assert self.ledger.commit(commit, records).ok
            self.clock.now_s += 3.0
        return done

    def canary(self, version: str) -> set[str]:
        """Logs of the canary share of a version."""
        drawn = select(PLANS.c.log_id).where(
            PLANS.c.pipeline_version == version,
            PLANS.c.turn >= Kind.CANARY.first_turn,
            PLANS.c.turn < Kind.CHOSEN.first_turn,
        )
        with self.store.reading() as connection:
            return set(connection.execute(drawn).scalars())

    def versions(self) -> set[str]:
        return {scene.pipeline_version for scene in self.ledger.current_scenes()}

    def states(self) -> dict[str, str]:
        return {log.log_id: log.state for log in self.ledger.status().logs}


class ReminingContract(StoreContract):
    """Every promise, tested on what `make_store` opens."""

    @pytest.fixture
    def fleet(self) -> Iterator[Fleet]:
        store = self.make_store()
        fleet = Fleet.on(store)
        assert isinstance(fleet, Fleet)
        fleet.listed("a", "b", "c")
        assert len(fleet.work_of("p1")) == 6
        yield fleet
        store.close()

    def test_only_the_score_changed_so_no_log_is_planned_or_mined(self, fleet: Fleet) -> None:
        before = fleet.ledger.status()
        assert fleet.work_of("p2") == [("rescore", log) for log in "abc"]
        after = fleet.ledger.status()
        assert fleet.versions() == {"p2"}
        assert (after.frames, after.scenes) == (before.frames, before.scenes)
        assert [log.damage for log in after.logs] == [log.damage for log in before.logs]
        assert fleet.ledger.settled("p2")
        assert fleet.ledger.backlog().remined_s == 0

    def test_a_lease_to_score_again_names_the_scenes_as_they_were_committed(
        self, fleet: Fleet
    ) -> None:
        stored = [(s.scene_id, s.sha256) for s in fleet.ledger.current_scenes() if s.log_id == "a"]
        lease = fleet.claim(version="p2")
        assert isinstance(lease, MineLease)
        assert lease.rescore is not None
        assert lease.rescore.pipeline_version == "p1"
        named = [(entry.scene_id, entry.sha256) for entry in lease.rescore.scenes]
        assert named == sorted(stored)

    def test_scenes_of_the_version_before_stay_until_theirs_are_done(self, fleet: Fleet) -> None:
        lease = fleet.claim(version="p2")
        assert fleet.versions() == {"p1"}
        assert fleet.commit_shard(lease, version="p2").ok
        assert fleet.versions() == {"p1", "p2"}

    def test_a_shard_without_its_overlays_is_mined(self, fleet: Fleet) -> None:
        lease = fleet.claim(version="p2")
        told = FailRequest(
            worker_id="w1",
            lease_id=lease.lease_id,
            error="the overlay is gone",
            permanent=True,
            not_rescored=True,
        )
        assert fleet.ledger.fail(told).ok
        assert fleet.ledger.status().parked == ()
        assert fleet.work_of("p2") == [("rescore", "b"), ("rescore", "c"), ("mine", "a")]
        assert fleet.versions() == {"p2"}

    def test_a_version_without_layers_is_mined(self, fleet: Fleet) -> None:
        request = ClaimRequest(worker_id="w1", pipeline_version="p9")
        assert isinstance(fleet.ledger.claim(request).grant, PlanLease)

    def test_a_log_that_the_version_before_did_not_finish_is_mined(self, fleet: Fleet) -> None:
        fleet.listed("a", "b", "c", "d")
        grant = fleet.claim(version="p1")
        assert fleet.commit_plan(grant, plan=plan_of("d", shards=1)).ok
        assert fleet.work_of("p2") == [
            ("mine", "d"),
            ("rescore", "a"),
            ("rescore", "b"),
            ("rescore", "c"),
        ]

    def test_a_changed_stream_mines_again_and_new_logs_first(self, fleet: Fleet) -> None:
        fleet.listed("a", "b", "c", "z")
        assert fleet.work_of("q2")[:2] == [("plan", "z"), ("plan", "a")]
        assert fleet.versions() == {"q2"}

    def test_none_keeps_the_scenes_and_mines_new_logs(self, fleet: Fleet) -> None:
        fleet.restarted("none")
        fleet.listed("a", "b", "c", "z")
        assert fleet.work_of("q2") == [("plan", "z"), ("mine", "z")]
        assert fleet.versions() == {"p1", "q2"}
        assert fleet.states() == {"a": "kept", "b": "kept", "c": "kept", "z": "done"}
        assert fleet.ledger.settled("q2")
        assert fleet.ledger.backlog().recordings["kept"] == 3

    def test_another_mode_takes_up_what_was_kept(self, fleet: Fleet) -> None:
        fleet.restarted("none")
        fleet.listed("a", "b", "c")
        assert fleet.work_of("q2") == []
        fleet.restarted("newest")
        fleet.listed("a", "b", "c")
        assert len(fleet.work_of("q2")) == 6
        assert fleet.versions() == {"q2"}

    def test_selected_mines_logs_with_selected_or_judged_scenes(self, fleet: Fleet) -> None:
        (best, *_) = [scene for scene in fleet.ledger.ranking() if scene.log_id == "b"]
        fleet.ledger.selections.save("week", budget=1, scenes=[best])
        fleet.restarted("selected")
        fleet.listed("a", "b", "c")
        assert fleet.work_of("q2") == [("plan", "b"), ("mine", "b")]
        (scene, *_) = [each for each in fleet.ledger.current_scenes() if each.log_id == "c"]
        fleet.ledger.verdicts.judge(
            JudgeRequest(
                key="k1", reviewer="ada", scene_id=scene.scene_id, verdict=Verdict("supervised")
            )
        )
        fleet.listed("a", "b", "c")
        assert fleet.work_of("q2") == [("plan", "c"), ("mine", "c")]
        assert fleet.states() == {"a": "kept", "b": "done", "c": "done"}

    def test_the_budget_of_a_day_is_kept_and_new_logs_do_not_wait(self, fleet: Fleet) -> None:
        fleet.restarted("newest", core_hours_a_day=2.0)
        fleet.listed("a", "b", "c")
        assert [kind for kind, _ in fleet.work_of("q2")].count("mine") == 2
        spent = fleet.ledger.backlog()
        assert spent.remined_s == 7200.0
        assert (spent.recordings["mining"], spent.recordings["resting"]) == (0, 1)
        assert spent.recordings["waiting"] == spent.recordings["planning"] == 0
        assert spent.oldest_listed_s is None, "what rests is no work that is late"
        assert fleet.versions() == {"p1", "q2"}
        fleet.listed("a", "b", "c", "z")
        assert ("mine", "z") in fleet.work_of("q2")
        fleet.clock.now_s += 86_400.0
        assert [kind for kind, _ in fleet.work_of("q2")] == ["mine"]
        assert fleet.versions() == {"q2"}

    def test_a_clock_that_was_years_ahead_leaves_no_budget_spent(self, fleet: Fleet) -> None:
        fleet.restarted("newest", core_hours_a_day=2.0)
        fleet.listed("a", "b", "c")
        fleet.clock.now_s += 9e7
        assert [kind for kind, _ in fleet.work_of("q2")].count("mine") == 2
        fleet.clock.now_s -= 9e7
        assert [kind for kind, _ in fleet.work_of("q2")] == ["mine"]
        assert fleet.versions() == {"q2"}

    def test_the_canary_share_is_finished_before_the_others_begin(self, fleet: Fleet) -> None:
        logs = [f"log-{number:02d}" for number in range(12)]
        fleet.listed(*logs)
        fleet.work_of("p1")
        fleet.restarted("newest", canary_share=0.3)
        fleet.listed(*logs)
        order = [log for kind, log in fleet.work_of("q2") if kind == "mine"]
        drawn = fleet.canary("q2")
        assert len(order) == 12
        assert 1 <= len(drawn) <= 6
        assert set(order[: len(drawn)]) == drawn


class TestReminingOnSqlite(OnSqlite, ReminingContract):
    """A file."""


class TestReminingOnPostgres(OnPostgres, ReminingContract):
    """A real server."""
