"""A state belongs to one bucket, on any database: another one does not take its scenes back."""

from abc import ABC, abstractmethod
from collections.abc import Iterator

import pytest

from schemas.work import Part, Recording
from service.errors import OtherBucketError
from service.store.engine import Store
from service.store.served_bucket import served_bucket
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, recording

HOME, AWAY = "s3://fleet", "s3://test-track"


def log(name: str, *, size: int) -> Recording:
    return Recording(log_id=name, parts=(Part(key=f"{name}.mcap", size=size, etag="z"),))


class ServedBucketContract(ABC):
    """Every promise, tested on what `make_store` opens."""

    @abstractmethod
    def make_store(self) -> Store:
        """Open the test's database, empty at first."""

    @pytest.fixture
    def world(self) -> Iterator[World]:
        store = self.make_store()
        yield World.on(store)
        store.close()

    def at(self, world: World) -> str:
        with world.store.reading() as connection:
            return served_bucket(connection)

    def serve(self, world: World, url: str, *listed: Recording) -> None:
        world.ledger.serve_bucket(url, listed)
        world.ledger.sync_recordings(listed)

    def test_the_first_bucket_is_noted_and_may_lose_all_its_logs(self, world: World) -> None:
        assert self.at(world) == ""
        self.serve(world, HOME, recording("a"), recording("b"))
        assert self.at(world) == HOME
        self.serve(world, HOME)
        assert not world.ledger.has_recordings()

    @pytest.mark.parametrize(
        "elsewhere",
        [
            (),
            (recording("x"), recording("y")),
            (recording("a"), recording("x"), recording("y")),
            (log("a", size=7), log("b", size=7), log("c", size=7)),  # same keys, other logs
        ],
    )
    def test_another_bucket_is_refused_and_changes_nothing(
        self, world: World, elsewhere: tuple[Recording, ...]
    ) -> None:
        self.serve(world, HOME, recording("a"), recording("b"), recording("c"))
        world.mine_all()
        scenes = world.ledger.current_scenes()
        assert scenes
        with pytest.raises(OtherBucketError, match=f"belongs to {HOME}: of its 3 logs {AWAY}"):
            world.ledger.serve_bucket(AWAY, elsewhere)
        assert world.ledger.current_scenes() == scenes
        assert self.at(world) == HOME

    def test_a_bucket_that_has_moved_is_noted_anew(self, world: World) -> None:
        self.serve(world, HOME, recording("a"), recording("b"), recording("c"), recording("d"))
        world.mine_all()
        self.serve(world, AWAY, log("a", size=100), log("b", size=100), recording("new"))
        assert self.at(world) == AWAY
        with pytest.raises(OtherBucketError):
            world.ledger.serve_bucket(HOME, (recording("c"), recording("d")))

    def test_a_state_without_logs_belongs_to_any_bucket(self, world: World) -> None:
        self.serve(world, HOME, recording("a"))
        self.serve(world, HOME)
        self.serve(world, AWAY, recording("x"))
        assert self.at(world) == AWAY


class TestServedBucketOnSqlite(OnSqlite, ServedBucketContract):
    pass


@pytest.mark.integration
class TestServedBucketOnPostgres(OnPostgres, ServedBucketContract):
    pass
