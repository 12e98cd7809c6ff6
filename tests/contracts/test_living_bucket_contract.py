"""What the ledger promises about a bucket that changes under it, on any database."""

import random
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import Table, func, select

from schemas.work import FailRequest, MineLease, NothingToDo, PlanLease, Recording, RenewRequest
from service.store.engine import Store, open_store
from service.store.leases import LEASES_KEPT_S, MOST_AWAITED_S
from service.store.ledger import Ledger
from service.store.tables import LEASES, RECORDINGS, SHARDS
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, plan_of, plan_of_parts, split

SETTLE_S = 30.0

WHAT_HAPPENS = {
    "claim": 30.0,
    "commit": 30.0,
    "fail": 3.0,
    "die": 3.0,
    "wait": 6.0,
    "back": 1.0,
    "grow": 4.0,
    "part": 5.0,
    "replace": 4.0,
    "delete": 2.0,
    "return": 3.0,
    "version": 0.4,
    "poll": 4.0,
}
"""And how often, of what may happen to a bucket, its workers and their service."""


class Subscriber:
    """Follows the events as the outbox publishes them, and holds what they leave."""

    def __init__(self, ledger: Ledger) -> None:
        self.ledger = ledger
        self.scenes: dict[str, str] = {}
        self.events: list[tuple[str, str]] = []

    def poll(self) -> list[tuple[str, str]]:
        """Take what is new; gives (`put` or `gone`, scene id) of each event."""
        events = self.ledger.unpublished(10_000)
        if events:
            self.ledger.mark_published(events[-1].seq)
        for event in events:
            if event.withdrawn:
                self.scenes.pop(event.scene_id, None)
            else:
                self.scenes[event.scene_id] = event.sha256
        return [("gone" if event.withdrawn else "put", event.scene_id) for event in events]

    def agrees(self) -> bool:
        """Whether it holds the ledger's current scenes."""
        self.poll()
        return self.scenes == current(self.ledger)


def current(ledger: Ledger) -> dict[str, str]:
    """Id to digest of the current scenes."""
    return {scene.scene_id: scene.sha256 for scene in ledger.current_scenes()}


def list_split(world: World, *etags: str) -> None:
    """List one log `a` in these parts; none: it is gone."""
    world.ledger.sync_recordings([split("a", *etags)] if etags else [])


def is_growing(world: World, lease: PlanLease) -> None:
    request = FailRequest(
        worker_id="w1", lease_id=lease.lease_id, error="no footer", permanent=False, growing=True
    )
    assert world.ledger.fail(request).ok


def rows(world: World, table: Table) -> int:
    with world.store.reading() as connection:
        return int(connection.execute(select(func.count()).select_from(table)).scalar_one())


def bytes_of(recording: Recording) -> tuple[tuple[int, str], ...]:
    return tuple((part.size, part.etag) for part in recording.parts)


class LivingBucketContract(ABC):
    """Every promise, tested on what `make_store` opens."""

    @abstractmethod
    def make_store(self) -> Store:
        """Open the test's database, empty at first."""

    @pytest.fixture
    def world(self) -> Iterator[World]:
        store = self.make_store()
        yield World.on(store, settle_s=SETTLE_S, planner=plan_of_parts)
        store.close()

    # Settling.

    def test_a_new_log_is_planned_at_once_if_it_is_complete(self, world: World) -> None:
        world.listed("a")
        lease = world.plan_lease()
        assert not lease.settled
        assert world.commit_plan(lease).ok
        assert isinstance(world.claim(), MineLease)

    def test_a_growing_log_rests_until_it_has_not_changed_for_a_while(self, world: World) -> None:
        world.listed("a")
        world.clock.now_s += 12
        is_growing(world, world.plan_lease())
        assert world.ledger.status().logs_by_state == {"settling": 1}
        assert not world.ledger.settled("p1")
        world.clock.now_s += SETTLE_S - 12 - 0.5
        assert isinstance(world.claim(), NothingToDo)
        world.clock.now_s += 0.5
        assert world.ledger.status().logs_by_state == {"waiting": 1}
        assert world.plan_lease().settled

    def test_a_log_that_is_found_growing_often_is_not_parked(self, world: World) -> None:
        for upload in range(9):
            world.listed("a", etag=f"{upload}")
            is_growing(world, world.plan_lease())
            world.clock.now_s += 10
        world.clock.now_s += SETTLE_S
        lease = world.plan_lease()
        assert (lease.settled, lease.recording.parts[0].etag) == (True, "a-8")
        assert world.ledger.status().parked == ()

    def test_a_log_without_its_predictions_is_looked_at_after_a_part_of_its_age(
        self, world: World
    ) -> None:
        world.listed("a")
        lease: PlanLease | MineLease | NothingToDo = world.plan_lease()
        pauses_s = []
        for _ in range(40):
            assert isinstance(lease, PlanLease)
            assert lease.waits
            assert world.fail(lease, awaits=True).ok
            assert world.ledger.status().logs_by_state == {"settling": 1}
            asked_s = world.clock.now_s
            while isinstance(lease := world.claim(), NothingToDo):
                world.clock.now_s += 5
            pauses_s.append(world.clock.now_s - asked_s)
        assert pauses_s[0] == SETTLE_S
        assert pauses_s == sorted(pauses_s)
        assert pauses_s[-1] == MOST_AWAITED_S
        assert world.ledger.status().parked == ()

    def test_an_answer_that_comes_when_it_has_settled_makes_it_ready_at_once(
        self, world: World
    ) -> None:
        world.listed("a")
        lease = world.plan_lease()
        world.clock.now_s += SETTLE_S - 1
        assert world.ledger.renew(RenewRequest(worker_id="w1", lease_id=lease.lease_id)).ok
        world.clock.now_s += 2
        is_growing(world, lease)
        assert world.plan_lease().settled

    def test_a_restart_does_not_begin_the_wait_anew(self, world: World) -> None:
        world.listed("a")
        world.clock.now_s += 20
        again = World.on(self.make_store(), clock=world.clock, settle_s=SETTLE_S)
        again.ledger.resume()
        again.listed("a")
        is_growing(again, again.plan_lease())
        world.clock.now_s += SETTLE_S - 20
        assert again.plan_lease().settled
        again.store.close()

    @pytest.mark.parametrize("step_s", [5.0, 45.0, 86_400.0])
    def test_a_clock_that_steps_back_makes_nothing_rest_for_ever(
        self, world: World, step_s: float
    ) -> None:
        world.listed("a")
        is_growing(world, world.plan_lease())
        world.clock.now_s -= step_s
        world.listed("a")
        waited_s = 0.0
        while not (isinstance(grant := world.claim(), PlanLease) and grant.settled):
            if isinstance(grant, PlanLease):
                is_growing(world, grant)
            world.clock.now_s += 1
            waited_s += 1
            assert waited_s <= 3 * SETTLE_S
        assert waited_s >= SETTLE_S

    def test_a_service_that_does_not_wait_calls_everything_settled(self, world: World) -> None:
        at_once = World.on(world.store, clock=world.clock)
        at_once.listed("a")
        assert at_once.plan_lease().settled
        world.clock.now_s -= 3600
        at_once.listed("b")
        assert at_once.plan_lease().settled

    def test_an_upload_in_progress_leaves_no_trace_of_each_listing(self, world: World) -> None:
        for upload in range(20):
            world.listed("a", etag=f"{upload}")
            is_growing(world, world.plan_lease())
        assert rows(world, RECORDINGS) == 1
        world.clock.now_s += SETTLE_S
        assert world.commit_plan(world.plan_lease()).ok
        world.listed("a", etag="next")
        assert rows(world, RECORDINGS) == 2

    def test_a_plan_made_of_a_forgotten_revision_is_refused(self, world: World) -> None:
        world.listed("a")
        lease = world.plan_lease()
        is_growing(world, lease)
        world.listed("a", etag="2")
        assert not world.commit_plan(lease).ok
        assert not world.ledger.renew(RenewRequest(worker_id="w1", lease_id=lease.lease_id)).ok

    # Replaced, grown, deleted.

    def test_scenes_of_a_grown_log_stay_until_its_new_plan(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        subscriber = Subscriber(world.ledger)
        subscriber.poll()
        before = current(world.ledger)
        for etag in ("2", "3"):
            world.listed("a", "b", etag=etag)
            is_growing(world, world.plan_lease())
            assert current(world.ledger) == before
        assert subscriber.poll() == []
        world.clock.now_s += SETTLE_S
        newest = world.ledger.last_seq()
        lease = world.plan_lease()
        assert lease.recording.log_id == "a"
        assert world.commit_plan(lease).ok
        gone = [("gone", scene_id) for scene_id in before if scene_id.startswith("a/")]
        assert subscriber.poll() == gone
        assert world.ledger.last_seq() == newest + len(gone)
        assert set(world.ids()) == {i for i in before if i.startswith("b/")}
        world.mine_all()
        assert set(world.ids()) == set(before)
        assert current(world.ledger) != before
        assert subscriber.agrees()

    def test_open_work_on_a_replaced_log_ends_at_the_listing(self, world: World) -> None:
        list_split(world, "1", "1")
        world.plan_all()
        done, held = world.mine_lease(), world.mine_lease()
        assert world.commit_shard(done).ok
        list_split(world, "2", "2")
        assert not world.ledger.renew(RenewRequest(worker_id="w1", lease_id=held.lease_id)).ok
        assert "replaced or deleted" in world.commit_shard(held).problem
        assert world.plan_lease().recording == split("a", "2", "2")
        assert len(world.ids()) == 3

    def test_a_log_replaced_by_one_that_cannot_be_mined_leaves_at_that(self, world: World) -> None:
        world.listed("a")
        world.mine_all()
        world.listed("a", etag="2")
        assert len(world.ids()) == 3
        assert world.commit_plan(world.plan_lease(), plan=plan_of("a", refused="no lidar")).ok
        assert world.ids() == []
        assert world.ledger.status().logs_by_state == {"refused": 1}

    @pytest.mark.parametrize("at_once", [True, False])
    def test_a_log_whose_new_plan_is_parked_leaves_at_that(
        self, world: World, at_once: bool
    ) -> None:
        world.listed("a")
        world.mine_all()
        world.listed("a", etag="2")
        for left in range(0 if at_once else 4, -1, -1):
            assert len(world.ids()) == 3
            assert world.fail(world.plan_lease(), permanent=at_once).ok
            world.clock.now_s += 60 * bool(left)
        assert world.ids() == []
        assert world.ledger.status().logs_by_state == {"parked": 1}

    def test_a_log_replaced_twice_before_it_is_planned_keeps_its_scenes_meanwhile(
        self, world: World
    ) -> None:
        list_split(world, "1", "1")
        world.mine_all()
        before = world.ids()
        list_split(world, "2", "2")
        list_split(world, "3", "3")
        assert world.ids() == before
        world.mine_all()
        subscriber = Subscriber(world.ledger)
        assert subscriber.agrees()
        assert current(world.ledger) == self.fresh(split("a", "3", "3"))

    def test_a_log_deleted_while_its_successor_waits_leaves_at_once(self, world: World) -> None:
        world.listed("a")
        world.mine_all()
        subscriber = Subscriber(world.ledger)
        subscriber.poll()
        before = world.ids()
        world.listed("a", etag="2")
        world.listed()
        assert world.ids() == []
        assert subscriber.poll() == [("gone", scene_id) for scene_id in before]
        world.listed("a", etag="2")
        assert world.ids() == []
        world.mine_all()
        assert len(world.ids()) == 3
        assert subscriber.agrees()

    def test_old_bytes_that_come_back_before_anything_was_planned_change_nothing(
        self, world: World
    ) -> None:
        world.listed("a")
        world.mine_all()
        newest, before = world.ledger.last_seq(), current(world.ledger)
        world.listed("a", etag="2")
        world.listed("a")
        assert current(world.ledger) == before
        assert world.ledger.last_seq() == newest
        assert isinstance(world.claim(), NothingToDo)

    def test_old_bytes_that_come_back_bring_their_scenes_and_end_the_others(
        self, world: World
    ) -> None:
        list_split(world, "1", "1")
        world.mine_all()
        before = current(world.ledger)
        subscriber = Subscriber(world.ledger)
        subscriber.poll()
        list_split(world, "2")
        world.mine_all()
        assert subscriber.agrees()
        assert len(subscriber.scenes) == 3
        list_split(world, "1", "1")
        assert current(world.ledger) == before
        # What both have keeps its key, which gets the old record: no delete in between.
        assert subscriber.poll() == [("put", scene_id) for scene_id in before]
        assert isinstance(world.claim(), NothingToDo)
        list_split(world, "2")
        assert current(world.ledger) == self.fresh(split("a", "2"))
        assert subscriber.agrees()

    def test_old_bytes_that_come_back_unplanned_wait_for_their_plan(self, world: World) -> None:
        list_split(world, "1")
        lease = world.plan_lease()
        list_split(world, "2")
        world.mine_all()
        before = current(world.ledger)
        list_split(world, "1")
        assert current(world.ledger) == before
        assert not world.ledger.renew(RenewRequest(worker_id="w1", lease_id=lease.lease_id)).ok
        world.mine_all()
        assert current(world.ledger) == self.fresh(split("a", "1"))

    def test_a_newer_pipeline_version_goes_by_the_revision_that_exists(self, world: World) -> None:
        list_split(world, "1", "1")
        world.mine_all("p1")
        list_split(world, "2", "1")
        world.mine_all("p2")
        assert {scene.pipeline_version for scene in world.ledger.current_scenes()} == {"p2"}
        list_split(world, "1", "1")
        assert {scene.pipeline_version for scene in world.ledger.current_scenes()} == {"p1"}
        world.mine_all("p2")
        assert {scene.pipeline_version for scene in world.ledger.current_scenes()} == {"p2"}
        assert current(world.ledger) == self.fresh(split("a", "1", "1"), version="p2")

    # Parts that come late.

    def test_a_late_part_costs_no_mining_of_earlier_ones(self, world: World) -> None:
        list_split(world, "1", "1", "1")
        assert world.mine_all() == [("a", 0), ("a", 1), ("a", 2)]
        subscriber = Subscriber(world.ledger)
        subscriber.poll()
        before = world.ledger.current_scenes()
        list_split(world, "1", "1", "1", "1")
        assert world.commit_plan(world.plan_lease()).ok
        kept = [scene for scene in before if scene in world.ledger.current_scenes()]
        assert kept == before[:6]  # with their numbers
        assert subscriber.poll() == [("gone", scene.scene_id) for scene in before[6:]]
        assert world.ledger.status().logs[0].shards == {"done": 2, "ready": 2}
        assert world.mine_all() == [("a", 2), ("a", 3)]  # the last one is no longer the last
        assert current(world.ledger) == self.fresh(split("a", "1", "1", "1", "1"))
        assert subscriber.agrees()

    def test_parts_that_come_one_by_one_are_mined_once_each_but_the_last(
        self, world: World
    ) -> None:
        subscriber = Subscriber(world.ledger)
        for count in range(1, 8):
            list_split(world, *"1" * count)
            mined_now = world.mine_all()
            assert mined_now == [("a", index) for index in (count - 2, count - 1) if index >= 0]
            assert subscriber.agrees()
        assert current(world.ledger) == self.fresh(split("a", *"1" * 7))

    def test_a_part_with_other_bytes_is_mined_anew(self, world: World) -> None:
        list_split(world, "1", "1", "1")
        world.mine_all()
        list_split(world, "1", "2", "1")
        assert world.mine_all() == [("a", 1)]
        assert current(world.ledger) == self.fresh(split("a", "1", "2", "1"))

    def test_a_file_that_is_replaced_by_a_like_one_is_mined_anew(self, world: World) -> None:
        list_split(world, "1")
        world.mine_all()
        list_split(world, "2")
        assert world.mine_all() == [("a", 0)]

    def test_a_part_that_is_deleted_again_leads_back(self, world: World) -> None:
        list_split(world, "1", "1")
        world.mine_all()
        before = current(world.ledger)
        subscriber = Subscriber(world.ledger)
        list_split(world, "1", "1", "1")
        world.mine_all()
        assert subscriber.agrees()
        list_split(world, "1", "1")
        assert current(world.ledger) == before
        assert subscriber.agrees()
        assert isinstance(world.claim(), NothingToDo)
        list_split(world, "1", "1", "1")
        assert current(world.ledger) == self.fresh(split("a", "1", "1", "1"))
        assert subscriber.agrees()
        list_split(world)
        assert world.ids() == []
        assert subscriber.agrees()

    def test_what_the_successor_mined_is_not_mined_again_when_old_bytes_come_back(
        self, world: World
    ) -> None:
        list_split(world, "1", "1", "1")
        world.plan_all()
        list_split(world, "1", "1", "1", "1")
        assert len(world.mine_all()) == 4
        list_split(world, "1", "1", "1")
        assert world.mine_all() == [("a", 2)]
        assert current(world.ledger) == self.fresh(split("a", "1", "1", "1"))

    def test_adopted_shards_tell_what_they_took_but_do_not_count_as_new(self, world: World) -> None:
        list_split(world, "1", "1")
        world.plan_all()
        first = world.mine_lease()
        assert world.commit_shard(first).ok
        world.clock.now_s += 10
        assert world.commit_shard(world.mine_lease()).ok
        world.clock.now_s += 10
        rate = world.ledger.status().frames_per_s
        list_split(world, "1", "1", "1")
        assert world.commit_plan(world.plan_lease()).ok
        status = world.ledger.status()
        assert (status.frames, status.bytes_read) == (60, 1100)
        assert status.frames_per_s == rate > 0

    def test_a_shard_that_was_adopted_is_what_a_third_revision_adopts(self, world: World) -> None:
        list_split(world, "1", "1", "1")
        world.mine_all()
        list_split(world, "1", "1", "2")
        world.mine_all()
        list_split(world, "1", "1", "3")
        assert world.mine_all() == [("a", 2)]
        with world.store.reading() as connection:
            adopted = connection.execute(
                select(SHARDS.c.revision, SHARDS.c.adopted_from).where(SHARDS.c.adopted_from != "")
            ).all()
        assert {row.adopted_from for row in adopted} == {split("a", "1", "1", "1").revision}
        assert len(adopted) == 4

    def test_an_old_pipeline_version_that_adopts_pushes_no_newer_scene_out(
        self, world: World
    ) -> None:
        list_split(world, "1", "1")
        world.mine_all("p1")
        world.mine_all("p2")
        list_split(world, "1", "1", "1")
        world.mine_all("p2")
        before = current(world.ledger)
        subscriber = Subscriber(world.ledger)
        subscriber.poll()
        assert world.mine_all("p1") == [("a", 1), ("a", 2)]
        assert current(world.ledger) == before
        assert subscriber.agrees()

    def test_a_new_pipeline_version_adopts_from_under_an_old_one(self, world: World) -> None:
        list_split(world, "1", "1", "1")
        world.mine_all("p1")
        world.mine_all("p2")
        list_split(world, "1", "1", "1", "1")
        world.mine_all("p1")
        assert {scene.pipeline_version for scene in world.ledger.current_scenes()} == {"p1"}
        assert world.mine_all("p2") == [("a", 2), ("a", 3)]
        final = split("a", "1", "1", "1", "1")
        assert current(world.ledger) == self.fresh(final, version="p2")

    # Leases.

    def test_leases_that_ended_long_ago_are_forgotten(self, world: World) -> None:
        world.listed("a")
        world.mine_all()
        world.ledger.expire()
        assert rows(world, LEASES) == 2
        world.clock.now_s += LEASES_KEPT_S + 3600
        world.listed("a", "b")
        held = world.plan_lease()
        world.ledger.expire()
        assert rows(world, LEASES) == 1
        assert world.commit_plan(held).ok

    # Everything at once.

    @pytest.mark.parametrize("seed", range(3))
    def test_in_the_end_the_scenes_are_those_of_a_fresh_run(self, seed: int) -> None:
        dice = random.Random(seed)  # noqa: S311 (a test's dice)
        store = self.make_store()
        world = World.on(store, settle_s=SETTLE_S, plan_ahead=3, planner=plan_of_parts)
        subscriber = Subscriber(world.ledger)
        bucket: dict[str, tuple[str, ...]] = {}
        past: list[dict[str, tuple[str, ...]]] = [{}]
        held: list[tuple[str, PlanLease | MineLease]] = []
        versions = ["p1"]
        world.register_pipeline("p1")
        for _ in range(250):
            log_id = f"log-{dice.randrange(3)}"
            parts = bucket.get(log_id, ())
            match dice.choices(list(WHAT_HAPPENS), list(WHAT_HAPPENS.values()))[0]:
                case "claim":
                    worker, version = f"w{dice.randrange(4)}", dice.choice(versions[-2:])
                    grant = world.claim(worker, version)
                    if not isinstance(grant, NothingToDo):
                        held.append((worker, grant))
                case "commit" if held:
                    worker, lease = held.pop(dice.randrange(len(held)))
                    if isinstance(lease, PlanLease):
                        world.commit_plan(lease, worker)
                    else:
                        with store.reading() as connection:
                            version = connection.execute(
                                select(LEASES.c.pipeline_version).where(
                                    LEASES.c.lease_id == lease.lease_id
                                )
                            ).scalar_one()
                        world.commit_shard(lease, worker, version)
                case "fail" if held:
                    worker, lease = held.pop(dice.randrange(len(held)))
                    how = dice.choice(("growing", "replaced", "given_back"))
                    if how == "growing" and not (isinstance(lease, PlanLease) and lease.settled):
                        how = "given_back"
                    world.fail(lease, worker, **{how: True})
                case "die" if held:
                    held.pop(dice.randrange(len(held)))
                case "wait":
                    world.clock.now_s += dice.choice((1.0, 10.0, 31.0))
                    world.ledger.expire()
                case "back":
                    world.clock.now_s -= 100
                case "grow" if parts:
                    bucket[log_id] = (*parts[:-1], f"{dice.randrange(3)}")
                case "part":
                    bucket[log_id] = (*parts, f"{dice.randrange(3)}")[:5]
                case "replace" if parts:
                    bucket[log_id] = tuple(f"{dice.randrange(3)}" for _ in parts)
                case "delete":
                    bucket.pop(log_id, None)
                case "return":
                    bucket = dict(dice.choice(past))
                case "version":
                    versions.append(f"p{len(versions) + 1}")
                    world.register_pipeline(versions[-1])
                case "poll":
                    assert subscriber.agrees()
            if bucket != past[-1]:
                past.append(dict(bucket))
                world.ledger.sync_recordings([split(i, *p) for i, p in sorted(bucket.items())])
        world.clock.now_s += 3600
        world.ledger.expire()
        final = [split(log_id, *parts) for log_id, parts in sorted(bucket.items())]
        world.ledger.sync_recordings(final)
        world.clock.now_s += 3600
        world.mine_all(versions[-1])
        assert world.ledger.status(versions[-1]).parked == ()
        logs = world.ledger.status(versions[-1]).logs
        same = {log.log_id for log in logs if log.state == "same"}  # another of its bytes was first
        mined = [each for each in final if each.log_id not in same]
        assert {bytes_of(each) for each in final} == {bytes_of(each) for each in mined}
        assert current(world.ledger) == self.fresh(*mined, version=versions[-1])
        assert subscriber.agrees()
        store.close()

    @pytest.fixture(autouse=True)
    def _aside(self, tmp_path: Path) -> None:
        self._runs = iter(tmp_path / f"fresh-{number}" for number in range(100))

    def fresh(self, *recordings: Recording, version: str = "p1") -> dict[str, str]:
        """What a service finds that never saw anything but this."""
        folder = next(self._runs)
        folder.mkdir()
        store = open_store(folder)
        world = World.on(store, planner=plan_of_parts)
        world.ledger.sync_recordings(recordings)
        world.mine_all(version)
        found = current(world.ledger)
        store.close()
        return found


class TestLivingBucketOnSqlite(OnSqlite, LivingBucketContract):
    pass


@pytest.mark.integration
class TestLivingBucketOnPostgres(OnPostgres, LivingBucketContract):
    pass
