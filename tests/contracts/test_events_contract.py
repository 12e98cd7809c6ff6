"""What the history promises a subscriber, on any database: who applies it holds what is current."""

import numpy as np
import pytest

from service.errors import NothingFoundError
from service.store.ledger import StoredScene
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, plan_of, recording
from tests.contracts.store_contract import StoreContract


class Follower:
    """A subscriber that asks now and then, a page at a time, and does as it is told."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.last = 0
        self.held: dict[str, str] = {}

    def ask(self, page: int) -> int:
        events = self._world.ledger.events_since(self.last, page)
        assert len(events) <= page
        for event in events:
            assert event.seq > self.last, "in the order of their numbers"
            self.last = event.seq
            if event.withdrawn:
                self.held.pop(event.scene_id, None)
            else:
                self.held[event.scene_id] = event.sha256
        return len(events)


class EventsContract(StoreContract):
    """Every promise, tested on what `make_store` opens."""

    def test_withdrawals_stand_among_the_scenes_in_their_order(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all()
        world.listed("b", "c")
        world.mine_all()
        expected = [(seq, False) for seq in range(10, 19)]
        expected += [(seq, True) for seq in range(19, 28)]
        expected += [(seq, False) for seq in range(28, 37)]
        assert _told(world.ledger.events_since(0, 100)) == expected
        for most in (1, 4, 9, 10, 20, 27):
            assert _told(world.ledger.events_since(0, most)) == expected[:most]
        assert _told(world.ledger.events_since(22, 8)) == expected[13:21]
        assert world.ledger.events_since(36, 100) == []

    def test_a_withdrawal_carries_no_record(self, world: World) -> None:
        world.listed("a")
        world.mine_all()
        world.listed()
        events = world.ledger.events_since(0, 100)
        assert len(events) == 9
        assert {event.record for event in events} == {b""}
        assert {event.log_id for event in events} == {"a"}

    def test_a_withdrawn_scene_is_refused_with_the_event_and_the_cause(self, world: World) -> None:
        def refusal(scene_id: str) -> str:
            with pytest.raises(NothingFoundError) as refused:
                world.ledger.scene(scene_id)
            assert str(refused.value).startswith(f"no current scene {scene_id!r}: it was ")
            return str(refused.value).partition("it was ")[2]

        world.listed("a", "b")
        world.mine_all()
        of_a, of_b = min(world.ids()), max(world.ids())
        record = world.ledger.scene(of_a)
        world.listed("b")
        deleted = "when its log was deleted from the bucket; it returns with the same log"
        assert refusal(of_a) == f"withdrawn with event 19, {deleted}"
        last = world.ledger.scene(of_a, withdrawn=True)
        assert record is not None
        assert last is not None
        assert last.record == record.record
        world.listed("b", etag="new")
        world.planner = lambda recording: plan_of(recording.log_id, shards=1)
        world.mine_all()
        assert "when its log was replaced in the bucket" in refusal(of_b)
        assert world.ledger.scene("b/lidar/never") is None
        world.listed("a")
        assert world.ledger.scene(of_a) is not None

    @pytest.mark.parametrize("seed", range(4))
    def test_whoever_asks_however_seldom_ends_with_what_is_current(
        self, world: World, seed: int
    ) -> None:
        rng = np.random.default_rng(seed)
        followers = [Follower(world) for _ in range(3)]
        version = 1
        for _ in range(18):
            # Logs come, go, come back as they were, are replaced; now and then the pipeline is.
            logs = [log_id for log_id in "abc" if rng.random() < 0.7]
            world.ledger.sync_recordings(
                [recording(log_id, etag=str(rng.integers(2))) for log_id in logs]
            )
            version += int(rng.random() < 0.15)
            if rng.random() < 0.8:
                world.mine_all(f"p{version}")
            for follower in followers:
                if rng.random() < 0.3:
                    follower.ask(int(rng.integers(1, 12)))
        current = {scene.scene_id: scene.sha256 for scene in world.ledger.current_scenes()}
        for follower in followers:
            while follower.ask(7):
                pass
            assert follower.held == current


def _told(events: list[StoredScene]) -> list[tuple[int, bool]]:
    return [(event.seq, event.withdrawn) for event in events]


class TestEventsOnSqlite(OnSqlite, EventsContract):
    pass


@pytest.mark.integration
class TestEventsOnPostgres(OnPostgres, EventsContract):
    pass
