"""Recordings with the same bytes under two names, on any database."""

from collections.abc import Iterator

import pytest

from schemas.canonical import sha256
from schemas.score import SceneScore
from schemas.transport.wire import encode_scene_score
from schemas.work import (
    Answer,
    ChunkRef,
    FailRequest,
    LogPlan,
    MineLease,
    NothingToDo,
    Part,
    PlanLease,
    Recording,
)
from service.errors import NothingFoundError
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, mined, plan_of, shard_commit
from tests.contracts.store_contract import StoreContract


def copy(log_id: str, content: str = "x") -> Recording:
    """A recording whose bytes are known by `content`, whatever its name."""
    return Recording(log_id=log_id, parts=(Part(key=f"{log_id}.mcap", size=100, etag=content),))


def plan_reading(log_id: str) -> LogPlan:
    """A plan whose shards read chunks of the one part."""
    plan = plan_of(log_id)
    shards = tuple(
        shard.model_copy(
            update={
                "vehicle": log_id.partition("/")[0],
                "chunks": (
                    ChunkRef(
                        part=0,
                        offset=64 + shard.index,
                        length=100,
                        start_ns=shard.start_ns,
                        end_ns=shard.end_ns,
                    ),
                ),
            }
        )
        for shard in plan.shards
    )
    return plan.model_copy(update={"shards": shards})


class Copies(World):
    """A world of recordings that may be copies."""

    def listed_as(self, *recordings: Recording) -> None:
        self.ledger.sync_recordings(recordings)

    def work(self, version: str = "p1") -> list[str]:
        """Plan, mine and take over all; gives what was done with which log, in order."""
        done: list[str] = []
        while not isinstance(grant := self.claim("w1", version), NothingToDo):
            if isinstance(grant, PlanLease):
                log_id = grant.recording.log_id
                assert self.commit_plan(grant, plan=plan_reading(log_id)).ok
                done.append(f"plan {log_id}")
                continue
            done.append(f"{'take' if grant.rescore else 'mine'} {grant.shard.log_id}")
            assert self.commit_copy(grant, version).ok
        return done

    def commit_copy(self, lease: MineLease, version: str = "p1") -> Answer:
        records = mined(lease.shard, pipeline_version=version)
        return self.ledger.commit(shard_commit(lease, records), records)

    def logs(self) -> set[str]:
        return {scene.log_id for scene in self.ledger.ranking()}

    def states(self) -> dict[str, str]:
        return {
            log.log_id: f"{log.state} {log.problem}".strip() for log in self.ledger.status().logs
        }


class SameBytesContract(StoreContract):
    """Every promise, tested on what `make_store` opens."""

    @pytest.fixture
    def bucket(self) -> Iterator[Copies]:
        store = self.make_store()
        bucket = Copies.on(store)
        assert isinstance(bucket, Copies)
        yield bucket
        store.close()

    def test_a_copy_is_mined_once_and_said(self, bucket: Copies) -> None:
        bucket.listed_as(copy("a/1"), copy("b/1"), copy("c/1", "other"))
        assert bucket.work() == ["plan a/1", "plan c/1"] + ["mine a/1"] * 3 + ["mine c/1"] * 3
        assert bucket.logs() == {"a/1", "c/1"}
        assert bucket.states()["b/1"] == "same same bytes as a/1"
        assert bucket.ledger.settled("p1")
        assert bucket.ledger.backlog().recordings["same"] == 1
        assert bucket.ledger.backlog().recordings["waiting"] == 0
        assert bucket.ledger.backlog().oldest_listed_s is None

    def test_rows_of_the_ranking_and_readers_of_a_scene_name_the_other_log(
        self, bucket: Copies
    ) -> None:
        bucket.listed_as(copy("a/1"), copy("b/1"), copy("c/1", "other"))
        bucket.work()
        rows = bucket.ledger.verdicts.with_verdicts(bucket.ledger.ranking())
        assert {row.log_id: row.same_logs for row in rows} == {"a/1": ("b/1",), "c/1": ()}
        scene_id = next(row.scene_id for row in rows if row.log_id == "a/1")
        with pytest.raises(NothingFoundError, match="b/1 has the same bytes as a/1"):
            bucket.ledger.scene(scene_id.replace("a/1", "b/1"))
        assert bucket.ledger.scene("c/2/lidar/1") is None

    def test_a_name_that_comes_later_never_replaces_the_first(self, bucket: Copies) -> None:
        bucket.listed_as(copy("b/1"))
        bucket.work()
        bucket.clock.now_s += 1.0
        bucket.listed_as(copy("a/1"), copy("b/1"))
        assert bucket.work() == []
        assert bucket.logs() == {"b/1"}
        assert bucket.states() == {"a/1": "same same bytes as b/1", "b/1": "done"}

    def test_the_second_name_takes_over_without_mining(self, bucket: Copies) -> None:
        bucket.listed_as(copy("a/1"), copy("b/1"))
        bucket.work()
        before = {scene.start_ns for scene in bucket.ledger.ranking()}
        bucket.listed_as(copy("b/1"))
        assert bucket.logs() == set()
        assert bucket.work() == ["plan b/1"] + ["take b/1"] * 3
        assert bucket.logs() == {"b/1"}
        assert {scene.start_ns for scene in bucket.ledger.ranking()} == before
        assert bucket.states() == {"b/1": "done"}
        assert bucket.ledger.status().frames == 180

    def test_a_lease_to_take_over_names_the_scenes_of_the_first_name(self, bucket: Copies) -> None:
        bucket.listed_as(copy("a/1"), copy("b/1"))
        bucket.work()
        stored = {scene.scene_id: scene.sha256 for scene in bucket.ledger.current_scenes()}
        bucket.listed_as(copy("b/1"))
        assert bucket.commit_plan(bucket.plan_lease(), plan=plan_reading("b/1")).ok
        lease = bucket.mine_lease()
        assert lease.rescore is not None
        assert lease.rescore.log_id == "a/1"
        assert lease.rescore.pipeline_version == "p1"
        named = {entry.scene_id: entry.sha256 for entry in lease.rescore.scenes}
        assert len(named) == 3
        assert named.items() <= stored.items()

    def test_a_renamed_log_is_not_mined_again(self, bucket: Copies) -> None:
        bucket.listed_as(copy("a/1"))
        bucket.work()
        bucket.listed_as(copy("z/1"))
        assert bucket.work() == ["plan z/1"] + ["take z/1"] * 3

    def test_a_shard_whose_overlays_are_gone_is_mined(self, bucket: Copies) -> None:
        bucket.listed_as(copy("a/1"))
        bucket.work()
        bucket.listed_as(copy("z/1"))
        assert bucket.commit_plan(bucket.plan_lease(), plan=plan_reading("z/1")).ok
        lease = bucket.mine_lease()
        told = FailRequest(
            worker_id="w1", lease_id=lease.lease_id, error="gone", permanent=True, not_rescored=True
        )
        assert bucket.ledger.fail(told).ok
        assert sorted(bucket.work()) == ["mine z/1", "take z/1", "take z/1"]
        assert bucket.ledger.backlog().remined_s == 0

    def test_what_the_first_name_left_unmined_is_mined(self, bucket: Copies) -> None:
        bucket.listed_as(copy("a/1"), copy("b/1"))
        assert bucket.commit_plan(bucket.plan_lease(), plan=plan_reading("a/1")).ok
        assert bucket.commit_copy(bucket.mine_lease()).ok
        bucket.listed_as(copy("b/1"))
        assert sorted(bucket.work()) == ["mine b/1", "mine b/1", "plan b/1", "take b/1"]

    def test_other_bytes_under_the_first_name_free_the_second(self, bucket: Copies) -> None:
        bucket.listed_as(copy("a/1"), copy("b/1"))
        bucket.work()
        bucket.listed_as(copy("a/1", "new"), copy("b/1"))
        done = bucket.work()
        assert done.count("mine a/1") == 3
        assert done.count("take b/1") == 3
        assert bucket.logs() == {"a/1", "b/1"}

    def test_a_name_that_becomes_a_copy_loses_its_scenes_and_gets_them_back(
        self, bucket: Copies
    ) -> None:
        bucket.listed_as(copy("a/1"), copy("b/1", "other"))
        bucket.work()
        own = {s.scene_id: s.sha256 for s in bucket.ledger.current_scenes() if s.log_id == "b/1"}
        bucket.clock.now_s += 1.0
        bucket.listed_as(copy("a/1", "other"), copy("b/1", "other"))
        assert bucket.logs() == {"b/1"}
        bucket.listed_as(copy("a/1", "third"), copy("b/1", "other"))
        bucket.work()
        assert bucket.logs() == {"a/1", "b/1"}
        again = {s.scene_id: s.sha256 for s in bucket.ledger.current_scenes() if s.log_id == "b/1"}
        assert again == own

    def test_empty_objects_and_stores_without_etags_are_no_copies(self, bucket: Copies) -> None:
        bucket.listed_as(copy("a/1", ""), copy("b/1", ""))
        assert set(bucket.states().values()) == {"waiting"}
        empty = [
            Recording(log_id=name, parts=(Part(key=f"{name}.mcap", size=0, etag="x"),))
            for name in ("c/1", "d/1")
        ]
        bucket.listed_as(*empty)
        assert set(bucket.states().values()) == {"waiting"}

    def test_scenes_of_the_second_name_are_as_if_it_had_been_mined(self, bucket: Copies) -> None:
        bucket.listed_as(copy("a/1"), copy("b/1"))
        bucket.work()
        bucket.listed_as(copy("b/1"))
        bucket.work()
        for scene in bucket.ledger.current_scenes():
            score = SceneScore.model_validate_json(scene.record)
            assert score.log_id == "b/1"
            assert sha256(encode_scene_score(score)) == scene.sha256


class TestSameBytesOnSqlite(OnSqlite, SameBytesContract):
    """A file."""


class TestSameBytesOnPostgres(OnPostgres, SameBytesContract):
    """A real server."""
