"""What the ledger promises, on any database: run on a SQLite file, and on a real PostgreSQL."""

import hashlib
import random
import threading

import pytest
from sqlalchemy import inspect, text
from structlog.testing import capture_logs

from schemas.score import SceneScore
from schemas.transport.wire import encode_scene_score
from schemas.work import (
    ClaimRequest,
    CommitRequest,
    Damage,
    FailRequest,
    MineLease,
    NothingToDo,
    PlanLease,
    RenewRequest,
)
from service.errors import StateUnusableError
from service.store.ledger import LeasePolicy, Ledger
from service.store.selections import SelectionExistsError
from service.store.tables import METADATA
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import (
    SCENES_PER_SHARD,
    Clock,
    World,
    expected_scenes,
    mined,
    plan_of,
    recording,
    score_of,
    shard_commit,
    shard_of,
)
from tests.contracts.store_contract import StoreContract


class LedgerContract(StoreContract):
    """Every promise, tested on what `make_store` opens; it must open the same database again."""

    # The schema.

    def test_the_migrated_schema_is_the_one_that_queries_use(self, world: World) -> None:
        with world.store.reading() as connection:
            found = inspect(connection)
            assert set(found.get_table_names()) == set(METADATA.tables)
            for name, table in METADATA.tables.items():
                columns = {column["name"]: column for column in found.get_columns(name)}
                assert set(columns) == set(table.columns.keys())
                for column in table.columns:
                    stored = columns[column.name]
                    assert stored["nullable"] == column.nullable, (name, column.name)
                    assert stored["type"]._type_affinity is column.type._type_affinity
                key = found.get_pk_constraint(name)["constrained_columns"]
                assert key == [column.name for column in table.primary_key.columns]

    def test_opening_twice_keeps_what_is_there(self, world: World) -> None:
        world.listed("a")
        world.mine_all()
        ids = world.ids()
        again = World.on(self.make_store())  # PostgreSQL: the earlier store is replaced by this one
        assert again.ids() == ids
        again.store.close()

    def test_a_state_of_a_newer_version_is_refused(self, world: World) -> None:
        with world.store.writing() as connection:
            connection.execute(text("INSERT INTO schema_version (version) VALUES (99)"))
        with pytest.raises(StateUnusableError, match=r"newer version: schema version 99"):
            self.make_store()

    # Listings.

    def test_a_listing_says_what_is_new_replaced_and_deleted(self, world: World) -> None:
        first = world.ledger.sync_recordings([recording("a"), recording("b"), recording("c")])
        again = world.ledger.sync_recordings([recording("a"), recording("b"), recording("c")])
        other = world.ledger.sync_recordings([recording("a"), recording("b", etag="2")])
        assert first.new == ("a", "b", "c")
        assert again == type(again)()
        assert (other.new, other.replaced, other.deleted) == ((), ("b",), ("c",))

    def test_a_listing_that_names_a_log_twice_is_refused_whole(self, world: World) -> None:
        with pytest.raises(ValueError, match="one log twice"):
            world.ledger.sync_recordings([recording("a"), recording("a", etag="2")])
        assert world.ledger.status().logs == ()

    def test_work_on_a_replaced_recording_is_void(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        lease = world.mine_lease()
        world.listed("a", etag="2")
        renewed = world.ledger.renew(RenewRequest(worker_id="w1", lease_id=lease.lease_id))
        answer = world.commit_shard(lease)
        assert not renewed.ok
        assert not answer.ok
        assert "replaced or deleted" in answer.problem
        assert world.ids() == []
        assert world.fail(lease).ok
        assert isinstance(world.claim(), PlanLease)

    def test_a_deleted_log_leaves_the_ranking_and_comes_back_unmined(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        every = world.ids()
        newest = world.ledger.last_seq()
        world.listed("b")
        assert all(scene_id.startswith("b/") for scene_id in world.ids())
        world.listed("a", "b")
        assert set(world.ids()) == set(every)
        assert isinstance(world.claim(), NothingToDo)
        returned = world.ledger.scenes_since(newest)
        assert [scene.scene_id for scene in returned] == [i for i in every if i.startswith("a/")]

    def test_a_log_that_comes_back_goes_on_where_it_was(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        assert world.commit_shard(world.mine_lease()).ok
        world.listed()
        assert isinstance(world.claim(), NothingToDo)
        world.listed("a")
        assert world.shards("ready") == 2
        world.mine_all()
        assert set(world.ids()) == set(expected_scenes(["a"]))

    def test_what_changed_under_a_reader_waits_for_the_next_listing(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        assert world.fail(world.mine_lease(), replaced=True).ok
        assert world.ledger.stale_logs() == ["a"]
        assert world.ledger.status().logs[0].state == "stale"
        assert not world.ledger.settled("p1")
        world.listed("a", etag="2")
        assert world.ledger.stale_logs() == []
        assert isinstance(world.claim(), PlanLease)

    def test_what_seemed_to_change_but_is_listed_as_it_was_is_tried_again(
        self, world: World
    ) -> None:
        world.listed("a")
        assert world.fail(world.plan_lease(), replaced=True).ok
        assert isinstance(world.claim(), NothingToDo)
        world.listed("a")
        world.clock.now_s += 60
        assert isinstance(world.claim(), PlanLease)

    # Claims.

    def test_nothing_is_to_be_done_in_an_empty_bucket(self, world: World) -> None:
        assert isinstance(world.claim(), NothingToDo)
        assert world.ledger.settled("p1")

    def test_a_log_that_appears_later_is_claimed_later(self, world: World) -> None:
        assert isinstance(world.claim(), NothingToDo)
        world.listed("a")
        assert world.plan_lease().recording.log_id == "a"

    def test_shards_are_mined_in_the_order_of_log_and_time(self, world: World) -> None:
        world.listed("b", "a")
        world.plan_all()
        leases = [world.mine_lease() for _ in range(6)]
        assert [(lease.shard.log_id, lease.shard.index) for lease in leases] == [
            (log_id, index) for log_id in ("a", "b") for index in range(3)
        ]
        assert isinstance(world.claim(), NothingToDo)

    def test_mining_starts_before_every_log_is_planned(self, world: World) -> None:
        near = World.on(world.store, plan_ahead=3)
        near.listed("a", "b", "c")
        assert near.commit_plan(near.plan_lease()).ok
        assert near.mine_lease().shard.log_id == "a"
        assert near.plan_lease().recording.log_id == "b"

    def test_no_two_claims_get_the_same_work(self, world: World) -> None:
        world.listed(*"abcdef")
        world.plan_all()
        got: list[tuple[str, str]] = []

        def work(name: str) -> None:
            while isinstance(grant := world.claim(name), MineLease):
                got.append((grant.shard.log_id, grant.shard.name))

        threads = [threading.Thread(target=work, args=(f"w{i}",)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(got) == len(set(got)) == 18

    def test_a_lease_tells_its_term_and_renewing_lengthens_it(self, world: World) -> None:
        world.listed("a")
        lease = world.plan_lease()
        assert lease.expires_s == 30.0
        for _ in range(4):
            world.clock.now_s += 20
            assert world.ledger.expire() == 0
            assert world.ledger.renew(RenewRequest(worker_id="w1", lease_id=lease.lease_id)).ok
        world.clock.now_s += 31
        assert world.ledger.expire() == 1
        assert not world.ledger.renew(RenewRequest(worker_id="w1", lease_id=lease.lease_id)).ok

    def test_another_worker_cannot_use_a_lease(self, world: World) -> None:
        world.listed("a")
        lease = world.plan_lease("w1")
        assert "belongs to worker w1" in world.commit_plan(lease, "w2").problem
        assert "belongs to worker w1" in world.fail(lease, "w2").problem
        assert not world.ledger.renew(RenewRequest(worker_id="w2", lease_id=lease.lease_id)).ok

    def test_a_lease_nobody_granted_is_refused(self, world: World) -> None:
        request = CommitRequest(worker_id="w1", lease_id="invented", plan=plan_of("a"))
        assert "no such lease" in world.ledger.commit(request, {}).problem

    # Ends of leases.

    def test_work_whose_worker_dies_each_time_is_parked(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        for _ in range(5):
            assert world.mine_lease().shard.index == 0
            world.clock.now_s += 31
            assert world.ledger.expire() == 1
            world.clock.now_s += 20  # its longest rest, and the head start of others
        assert world.mine_lease().shard.index == 1
        (parked,) = world.ledger.status().parked
        assert (parked.log_id, parked.shard, parked.attempts) == ("a", "lidar-00000", 5)
        assert parked.error == "worker died 5 times while mining it"

    def test_a_transient_failure_rests_longer_each_time_and_is_parked_at_last(
        self, world: World
    ) -> None:
        world.listed("a")
        for pause_s in (2, 4, 8, 16):
            assert world.fail(world.plan_lease()).ok
            world.clock.now_s += pause_s - 0.5
            assert isinstance(world.claim(), NothingToDo)
            world.clock.now_s += 0.5
        assert world.fail(world.plan_lease()).ok
        world.clock.now_s += 3600
        assert isinstance(world.claim(), NothingToDo)
        assert world.ledger.status().parked[0].error == "cannot read chunk"
        assert world.ledger.settled("p1")

    def test_a_permanent_failure_is_parked_at_once(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        assert world.fail(world.mine_lease(), permanent=True).ok
        world.mine_all()
        status = world.ledger.status()
        assert [work.shard for work in status.parked] == ["lidar-00000"]
        assert status.shards_by_state == {"done": 2, "parked": 1}
        assert world.ledger.settled("p1")

    def test_the_leases_of_an_ended_pool_are_free_at_once_and_count_no_attempt(
        self, world: World
    ) -> None:
        world.listed("a")
        world.plan_all()
        for _ in range(9):
            for worker in ("pool_1-w1", "pool_1-w2", "pool%1-w1"):
                world.mine_lease(worker)
            assert world.ledger.free_leases("pool_1-") == 2
            assert world.ledger.free_leases("pool%1-") == 1
        assert world.shards("ready") == 3

    def test_a_lease_given_back_by_a_worker_that_stops_counts_no_attempt(
        self, world: World
    ) -> None:
        world.listed("a")
        world.plan_all()
        for _ in range(9):
            lease = world.mine_lease("w1")
            request = FailRequest(
                worker_id="w1",
                lease_id=lease.lease_id,
                error="told to stop",
                permanent=False,
                given_back=True,
            )
            assert world.ledger.fail(request).ok
        assert world.shards("ready") == 3

    def test_a_worker_that_is_known_to_be_dead_gives_back_at_once(self, world: World) -> None:
        world.listed("a")
        world.plan_lease("w1")
        assert world.ledger.worker_died("w2") == 0
        assert world.ledger.worker_died("w1") == 1
        assert isinstance(world.claim("w2"), NothingToDo)
        world.clock.now_s += 2
        assert isinstance(world.claim("w2"), PlanLease)

    def test_leases_live_on_when_the_service_was_away(self, world: World) -> None:
        world.listed("a")
        lease = world.plan_lease()
        world.clock.now_s += 3600
        reborn = Ledger(world.store, now_s=world.clock)
        reborn.resume()
        assert reborn.expire() == 0
        assert reborn.renew(RenewRequest(worker_id="w1", lease_id=lease.lease_id)).ok

    def test_a_clock_that_steps_back_holds_nothing_up(self, world: World) -> None:
        world.listed("a", "b")
        world.plan_lease("w1")
        assert world.fail(world.plan_lease("w2"), "w2").ok
        world.clock.now_s -= 86_400
        assert isinstance(world.claim("w2"), PlanLease)  # rest is over
        assert world.ledger.expire() == 0
        world.clock.now_s += 31
        assert world.ledger.expire() == 2  # and leases last no longer than a term

    # Commits.

    def test_a_refused_log_says_why(self, world: World) -> None:
        world.listed("a")
        plan = plan_of("a", refused="no lidar: topics are /imu")
        assert world.commit_plan(world.plan_lease(), plan=plan).ok
        (log,) = world.ledger.status().logs
        assert (log.state, log.problem) == ("refused", "no lidar: topics are /imu")
        assert isinstance(world.claim(), NothingToDo)
        assert world.ledger.settled("p1")

    def test_a_commit_stores_scenes_once_however_often_it_is_sent(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        lease = world.mine_lease()
        assert all(world.commit_shard(lease).ok for _ in range(3))
        assert len(world.ids()) == SCENES_PER_SHARD
        assert world.ledger.last_seq() == SCENES_PER_SHARD
        assert world.ledger.status().frames == 60

    def test_a_plan_sent_twice_is_taken_once(self, world: World) -> None:
        world.listed("a")
        lease = world.plan_lease()
        assert world.commit_plan(lease).ok
        again = plan_of("a").model_copy(update={"bytes_read": 9})
        assert world.commit_plan(lease, plan=again).ok
        assert world.shards("ready") == 3
        assert "other results" in world.commit_plan(lease, plan=plan_of("a", shards=2)).problem

    def test_what_did_not_arrive_is_named_and_may_come_with_the_next_commit(
        self, world: World
    ) -> None:
        world.listed("a")
        world.plan_all()
        lease = world.mine_lease()
        records = mined(lease.shard)
        digests = list(records)
        staged = {digests[0]: records[digests[0]], digests[1]: b"damaged on the way"}
        request = shard_commit(lease, records)
        answer = world.ledger.commit(request, staged)
        lost = [entry.scene_id for entry in request.manifest[1:]]
        assert (answer.ok, list(answer.missing)) == (False, lost)
        assert world.ids() == []
        sent = [records[digest] for digest in digests[1:]]
        assert world.ledger.commit(shard_commit(lease, records, sent=sent), staged).ok
        assert [scene.record for scene in world.ledger.current_scenes()] == list(records.values())

    def test_a_late_commit_counts_when_nobody_was_faster(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        slow = world.mine_lease("slow")
        world.clock.now_s += 31
        assert world.ledger.expire() == 1
        assert world.commit_shard(slow, "slow").ok
        assert world.mine_lease("fast").shard.index == 1

    def test_of_two_workers_on_one_shard_the_second_is_told_that_all_is_well(
        self, world: World
    ) -> None:
        world.listed("a")
        world.plan_all()
        slow = world.mine_lease("slow")
        world.clock.now_s += 31
        world.ledger.expire()
        world.clock.now_s += 2
        fast = world.mine_lease("fast")
        assert world.commit_shard(slow, "slow").ok
        assert world.commit_shard(fast, "fast").ok
        assert world.fail(fast, "fast").ok
        assert len(world.ids()) == SCENES_PER_SHARD
        assert world.shards("done") == 1

    def test_parked_work_that_comes_in_after_all_is_taken(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        slow = world.mine_lease("slow")
        for _ in range(4):
            world.clock.now_s += 31
            world.ledger.expire()
            world.clock.now_s += 20
            world.mine_lease("slower")
        world.clock.now_s += 31
        world.ledger.expire()
        assert world.shards("parked") == 1
        assert world.commit_shard(slow, "slow").ok
        assert world.ledger.status().parked == ()

    def test_a_second_result_that_differs_is_refused_and_said(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        lease = world.mine_lease()
        assert world.commit_shard(lease).ok
        other = dict(list(mined(lease.shard).items())[:2])
        answer = world.ledger.commit(shard_commit(lease, other), other)
        assert "committed before with other results" in answer.problem
        assert len(world.ids()) == SCENES_PER_SHARD

    @pytest.mark.parametrize(
        ("record", "problem"),
        [
            (b"{}", "not a scene score: scene_id"),
            (b"\xff", "not a scene score"),
            (encode_scene_score(score_of("b", 5)), "is of another scene"),
        ],
    )
    def test_a_record_that_is_no_score_of_its_scene_is_refused(
        self, world: World, record: bytes, problem: str
    ) -> None:
        world.listed("a")
        world.plan_all()
        lease = world.mine_lease()
        request = shard_commit(lease, mined(lease.shard))
        digest = hashlib.sha256(record).hexdigest()
        entry = request.manifest[0].model_copy(update={"sha256": digest})
        request = request.model_copy(update={"manifest": (entry,)})
        assert problem in world.ledger.commit(request, {digest: record}).problem
        assert world.shards("leased") == 1

    @pytest.mark.parametrize(
        "score",
        [
            score_of("b", 5),
            score_of("a", 5, topic="/other"),
            score_of("a", 5, pipeline_version="p2"),
        ],
    )
    def test_a_scene_of_another_log_lidar_or_pipeline_is_refused(
        self, world: World, score: SceneScore
    ) -> None:
        world.listed("a")
        world.plan_all()
        lease = world.mine_lease()
        record = encode_scene_score(score)
        records = {hashlib.sha256(record).hexdigest(): record}
        answer = world.ledger.commit(shard_commit(lease, records), records)
        assert "but the lease is for" in answer.problem
        assert world.ids() == []

    def test_a_scene_belongs_to_one_shard(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        first, second = world.mine_lease(), world.mine_lease()
        assert world.commit_shard(first).ok
        records = mined(first.shard)
        answer = world.ledger.commit(shard_commit(second, records), records)
        assert "was stored before, from shard lidar-00000" in answer.problem

    def test_a_plan_for_a_shard_lease_is_refused(self, world: World) -> None:
        world.listed("a", "b")
        plan = world.plan_lease()
        assert "is of another log" in world.commit_plan(plan, plan=plan_of("b")).problem
        twice = plan_of("a").model_copy(update={"shards": (shard_of("a", 0, of=1),) * 2})
        assert "names a shard twice" in world.commit_plan(plan, plan=twice).problem
        request = CommitRequest(worker_id="w1", lease_id=plan.lease_id)
        assert "lease is for the plan of a" in world.ledger.commit(request, {}).problem

    def test_damage_is_kept_and_shown_once_per_stretch(self, world: World) -> None:
        world.listed("a")
        world.plan_all()
        lease = world.mine_lease()
        records = mined(lease.shard)
        known = plan_of("a").damage[0]
        found = Damage(key="a.mcap", offset=4, bytes=8, what="CRC differs")
        request = shard_commit(lease, records).model_copy(update={"damage": (known, found)})
        assert world.ledger.commit(request, records).ok
        assert world.ledger.status().logs[0].damage == (found, known)

    # Pipeline versions.

    def test_a_newer_pipeline_version_takes_over_stretch_by_stretch(self, world: World) -> None:
        world.listed("a")
        world.mine_all("p1")
        world.ledger.mark_published(world.ledger.last_seq())
        world.plan_all("p2")
        assert len(world.ids()) == 9
        assert world.commit_shard(world.mine_lease("w1", "p2"), version="p2").ok
        versions = [scene.pipeline_version for scene in world.ledger.current_scenes()]
        assert sorted(versions) == ["p1"] * 6 + ["p2"] * 3
        assert [event.withdrawn for event in world.ledger.unpublished(100)] == [False] * 3
        world.mine_all("p2")
        assert {scene.pipeline_version for scene in world.ledger.current_scenes()} == {"p2"}
        assert set(world.ids()) == set(expected_scenes(["a"]))

    def test_another_grid_leaves_nothing_of_the_old_one(self, world: World) -> None:
        world.listed("a")
        world.mine_all("p1")
        assert world.commit_plan(
            world.plan_lease("w1", "p2"), plan=plan_of("a", shards=1, cells=1)
        ).ok
        assert world.commit_shard(world.mine_lease("w1", "p2"), version="p2").ok
        assert [scene.pipeline_version for scene in world.ledger.current_scenes()] == ["p2"]
        gone = [event for event in world.ledger.unpublished(100) if event.withdrawn]
        assert len(gone) == 8  # nine went, one was replaced under its own key

    def test_a_worker_of_the_old_version_does_not_push_out_the_new(self, world: World) -> None:
        world.listed("a")
        world.plan_all("p1")
        old = world.mine_lease("w1", "p1")
        world.mine_all("p2")
        ids, newest = world.ids(), world.ledger.last_seq()
        assert world.commit_shard(old).ok
        assert world.ids() == ids
        assert world.ledger.last_seq() == newest

    def test_each_pipeline_version_is_settled_by_itself(self, world: World) -> None:
        world.listed("a")
        assert not world.ledger.settled("p1")
        world.mine_all("p1")
        assert world.ledger.settled("p1")
        assert not world.ledger.settled("p2")

    # Outbox and history.

    def test_events_are_numbered_without_gaps_and_published_once(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        seen: list[int] = []
        while batch := world.ledger.unpublished(4):
            seen += [event.seq for event in batch]
            world.ledger.mark_published(batch[-1].seq)
        assert seen == list(range(1, 19))
        world.ledger.mark_published(3)
        assert world.ledger.unpublished(4) == []

    def test_history_is_served_from_any_number_on(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        every = world.ledger.current_scenes()
        assert world.ledger.scenes_since(0) == every
        assert world.ledger.scenes_since(5, 3) == every[5:8]
        assert world.ledger.newest_scenes(4) == every[-4:]
        assert world.ledger.scenes_since(18) == []
        assert world.ledger.scene(every[7].scene_id) == every[7]
        assert world.ledger.scene("a/lidar/0") is None
        assert every[7].decoded().scene_id == every[7].scene_id

    def test_a_version_that_takes_the_place_of_another_is_said_once(self, world: World) -> None:
        world.listed("a")
        with capture_logs() as lines:
            for version in ("p1", "p1", "p2", "p1", "p2"):
                world.claim(version=version)
        said = [(line["pipeline_version"], line["before"]) for line in lines]
        assert said == [("p2", "p1")]

    # Ranking and selection.

    def test_a_selection_is_durable_and_never_changes(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        chosen = world.ledger.proposals.select(budget=2)
        first = world.ledger.selections.save(None, budget=2, scenes=chosen)
        named = world.ledger.selections.save(
            "for-monday", budget=3, scenes=world.ledger.proposals.select(budget=3)
        )
        assert first.name == "selection-1"
        assert len(chosen) == 2
        assert list(first.scenes) == chosen
        assert world.ledger.selections.save("for-monday", budget=3, scenes=named.scenes) == named
        with pytest.raises(SelectionExistsError, match="'for-monday' exists"):
            world.ledger.selections.save("for-monday", budget=2, scenes=chosen)
        assert world.ledger.selections.one("for-monday") == named
        assert named.strategy == "best-distinct"
        assert [each.scenes for each in world.ledger.selections.listed()] == [2, 3]
        assert world.ledger.selections.one("for-tuesday") is None
        assert world.ledger.selections.all() == [first, named]

    def test_a_default_name_avoids_names_given_by_hand(self, world: World) -> None:
        world.ledger.selections.save("selection-2", budget=1, scenes=[])
        world.ledger.selections.save(None, budget=1, scenes=[])
        names = [selection.name for selection in world.ledger.selections.all()]
        assert len(set(names)) == 2

    # Status.

    def test_status_adds_up(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        status = world.ledger.status()
        assert status.pipeline_version == "p1"
        assert status.logs_by_state == {"done": 2}
        assert status.shards_by_state == {"done": 6}
        assert (status.scenes, status.frames) == (18, 360)
        assert (status.bytes_read, status.bytes_needed) == (6600, 6000)
        assert status.points.model_dump() == {
            "both_static": 18 * 720,
            "both_dynamic": 18 * 40,
            "only_semantic_dynamic": 18 * 40,
            "only_predictive_dynamic": 0,
            "not_compared": 18 * 200,
        }
        assert status.logs[0].plan_range_reads == 2
        assert status.logs[0].mine_range_reads == 12
        assert status.logs[0].vehicle == "bus-7"

    def test_the_rate_is_that_of_the_last_minute(self, world: World) -> None:
        world.listed("a", "b")
        world.plan_all()
        for pause_s in (1000.0, 10.0, 5.0, 15.0):
            world.clock.now_s += pause_s
            assert world.ledger.status().frames_per_s == pytest.approx(
                {1000.0: 0.0, 10.0: 0.0, 5.0: 60 / 15, 15.0: 120 / 30}[pause_s]
            )
            assert world.commit_shard(world.mine_lease()).ok
        world.clock.now_s += 3600
        assert world.ledger.status().frames_per_s == 0.0

    # Everything at once.

    @pytest.mark.parametrize("seed", range(3))
    def test_nothing_is_lost_or_doubled_whatever_happens(self, seed: int) -> None:
        dice = random.Random(seed)  # noqa: S311 (a test's dice)
        logs = [f"log-{number}" for number in range(5)]
        clock = Clock()
        policy = LeasePolicy(max_attempts=1000, backoff_s=0.5, max_backoff_s=2.0, plan_ahead=4)
        store = self.make_store()
        ledger = Ledger(store, now_s=clock, policy=policy)
        ledger.sync_recordings([recording(log_id) for log_id in logs])
        held: list[tuple[str, PlanLease | MineLease]] = []
        acknowledged: dict[str, str] = {}
        published: list[int] = []
        for step in range(300):
            match dice.choices(
                ("claim", "commit", "again", "lost", "fail", "die", "wait", "restart", "publish"),
                (30, 25, 5, 5, 3, 5, 8, 2, 5),
            )[0]:
                case "claim":
                    worker = f"w{dice.randrange(4)}"
                    request = ClaimRequest(worker_id=worker, pipeline_version="p1")
                    grant = ledger.claim(request).grant
                    if not isinstance(grant, NothingToDo):
                        held.append((worker, grant))
                case ("commit" | "again" | "lost") as how if held:
                    worker, lease = held[dice.randrange(len(held))]
                    if how == "commit":
                        held.remove((worker, lease))
                    if isinstance(lease, PlanLease):
                        plan = plan_of(lease.recording.log_id)
                        finished = CommitRequest(
                            worker_id=worker, lease_id=lease.lease_id, plan=plan
                        )
                        assert ledger.commit(finished, {}).ok
                        continue
                    records = mined(lease.shard)
                    arrived = {d: r for d, r in records.items() if how != "lost" or step % 2}
                    commit = shard_commit(lease, records, worker=worker)
                    answer = ledger.commit(commit, arrived)
                    if answer.ok:
                        acknowledged |= {e.scene_id: e.sha256 for e in commit.manifest}
                    else:
                        assert set(answer.missing) == {e.scene_id for e in commit.manifest}
                case "fail" if held:
                    worker, lease = held.pop(dice.randrange(len(held)))
                    World(store, clock, ledger).fail(lease, worker)
                case "die" if held:
                    held.pop(dice.randrange(len(held)))
                case "wait":
                    clock.now_s += dice.choice((1.0, 10.0, 31.0))
                    ledger.expire()
                case "restart":
                    store.close()
                    store = self.make_store()
                    ledger = Ledger(store, now_s=clock, policy=policy)
                    ledger.resume()
                    stored = {scene.scene_id: scene.sha256 for scene in ledger.current_scenes()}
                    assert acknowledged == stored
                case "publish":
                    events = ledger.unpublished(dice.randrange(1, 20))
                    published += [event.seq for event in events]
                    if events:
                        ledger.mark_published(events[-1].seq)
        clock.now_s += 3600
        ledger.expire()
        World(store, clock, ledger).mine_all()
        scenes = ledger.current_scenes()
        published += [event.seq for event in ledger.unpublished(1000)]
        assert {scene.scene_id: scene.sha256 for scene in scenes} == expected_scenes(logs)
        assert len(scenes) == len(expected_scenes(logs))
        assert published == list(range(1, len(scenes) + 1))
        assert ledger.settled("p1")
        store.close()


class TestLedgerOnSqlite(OnSqlite, LedgerContract):
    pass


@pytest.mark.integration
class TestLedgerOnPostgres(OnPostgres, LedgerContract):
    pass
