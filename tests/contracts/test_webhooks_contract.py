"""Webhooks by SQLite and by PostgreSQL: which events, once each, in order, behind failures."""

import base64
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import pytest

from service.background.mode_watch import ModeWatch
from service.background.webhook_terms import WebhookTerms
from service.background.webhooks import WebhookDelivery
from service.curation.comparison import ComparedSide, CompareRequest, Comparison
from service.curation.event_types import EVENTS
from service.curation.mode_rows import ModeExample, ModeRow, ModesReply
from service.curation.webhooks import gate_notice
from service.store.proposals import Proposals
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World
from tests.contracts.test_comparisons_contract import two_versions
from tests.integration.running import until
from tests.webhook_receiver import SECRET, Receiver, receiver

MIN_SCORE = 0.5


class WebhooksContract:
    """Check the messages that receivers get, on each database."""

    def make_store(self) -> Any:
        raise NotImplementedError

    @pytest.fixture
    def world(self) -> Iterator[World]:
        store = self.make_store()
        yield World.on(store)
        store.close()

    @contextmanager
    def delivering(
        self, world: World, *receivers: Receiver, events: tuple[str, ...] = EVENTS
    ) -> Iterator[WebhookDelivery]:
        terms = WebhookTerms(
            urls=tuple(each.url for each in receivers),
            secret=base64.b64decode(SECRET),
            events=frozenset(events),
            min_score=MIN_SCORE,
        )
        with WebhookDelivery(
            world.ledger.webhooks, terms, now_s=lambda: 1.7e9, first_wait_s=0.05
        ) as delivery:
            yield delivery

    def test_scenes_above_the_score_and_selections_come_once_in_order(self, world: World) -> None:
        world.listed("before")
        world.mine_all()
        with receiver() as one, receiver() as other:
            with self.delivering(world, one, other, events=("scene.new", "selection.made")):
                world.listed("before", "a", "b")
                world.mine_all()
                world.ledger.selections.save("week", budget=1, scenes=world.ledger.ranking(most=1))
                wanted = [
                    row.scene_id
                    for row in world.ledger.ranking()
                    if row.score >= MIN_SCORE and row.log_id != "before"
                ]
                assert wanted
                for each in (one, other):
                    until(partial(has_selection, each), "the selection came")
                    assert {data["scene_id"] for data in each.of("scene.new")} == set(wanted)
                    assert len(each.ids()) == len(set(each.ids())) == len(wanted) + 1
                    numbers = [data["seq"] for data in each.of("scene.new")]
                    assert numbers == sorted(numbers)
                    assert each.of("selection.made")[0]["name"] == "week"
            assert one.ids() == other.ids()

    def test_an_event_waits_for_a_receiver_that_fails_and_delays_no_other(
        self, world: World
    ) -> None:
        with receiver() as failing, receiver() as sound:
            failing.status = lambda taken: 302 if taken else 500
            with self.delivering(world, failing, sound) as delivery:
                world.listed("a")
                world.mine_all()
                until(lambda: bool(sound.taken), "the sound one has an event")
                until(lambda: failing.refused >= 2, "the other was tried again")
                assert failing.taken == []
                assert delivery.late_s > 0
                failing.status = lambda _: 200
                until(lambda: failing.ids() == sound.ids(), "all came")
                until(lambda: delivery.late_s == 0, "none waits")

    def test_what_a_receiver_has_is_not_sent_again_after_a_restart(self, world: World) -> None:
        with receiver() as one:
            with self.delivering(world, one):
                world.listed("a")
                world.mine_all()
                until(lambda: bool(one.taken), "an event came")
            before = one.ids()
            world.listed("a", "b")
            world.mine_all()
            with self.delivering(world, one):
                until(lambda: len(one.ids()) > len(before), "those of the absence came")
        assert len(one.ids()) == len(set(one.ids()))

    def test_a_mode_that_is_new_comes_once_and_one_that_was_there_does_not(
        self, world: World, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        there = [mode("mode-1")]
        monkeypatch.setattr(
            Proposals,
            "modes",
            lambda _: ModesReply(modes=tuple(there), tracks=1, without=0, hours=1.0),
        )
        counted: list[int] = []
        with receiver() as one, self.delivering(world, one):
            assert ModeWatch(world.ledger, on_new=counted.append).look() == 0
            there.append(mode("mode-2"))
            assert ModeWatch(world.ledger, on_new=counted.append).look() == 1
            assert ModeWatch(world.ledger, on_new=counted.append).look() == 0
            until(lambda: bool(one.of("mode.new")), "the mode came")
        assert [data["mode"]["mode_id"] for data in one.of("mode.new")] == ["mode-2"]
        assert counted == [1]

    def test_a_comparison_comes_once_for_each_result(self, world: World) -> None:
        two_versions(world)
        older, newer = (ComparedSide(software_version=name) for name in ("2.4", "2.5"))
        asked = CompareRequest(a=older, b=newer)
        found = as_regressed(world.ledger.comparisons.compare(asked))
        equal = world.ledger.comparisons.compare(CompareRequest(a=older, b=older))
        webhooks = world.ledger.webhooks
        with receiver() as one, self.delivering(world, one):
            again = as_regressed(world.ledger.comparisons.compare(asked))
            for each, new in ((found, 1), (again, 0), (equal, 1)):
                name, body = gate_notice(each)
                assert webhooks.note("gate", {name: body}) == new
            until(lambda: len(one.of("gate.compared")) == 2, "both results came")
        regressed, passed = one.of("gate.compared")
        assert (regressed["a"], regressed["b"]) == ("software 2.4", "software 2.5")
        assert not regressed["passed"]
        assert regressed["regressed_groups"] == ["class pedestrian"]
        assert "regressed" in regressed["result"]
        assert passed["passed"]
        assert passed["regressed_groups"] == []
        assert len(set(one.ids())) == 2

    def test_a_scene_that_comes_back_has_the_id_that_it_had(self, world: World) -> None:
        with receiver() as one, self.delivering(world, one):
            world.listed("a")
            world.mine_all()
            world.ledger.selections.save("begin", budget=1, scenes=world.ledger.ranking(most=1))
            until(lambda: bool(one.of("selection.made")), "an event came")
            world.listed()
            world.listed("a")
            world.mine_all()
            world.ledger.selections.save("end", budget=1, scenes=world.ledger.ranking(most=1))
            until(lambda: len(one.of("selection.made")) == 2, "what came after it came")
        scenes = {data["scene_id"] for data in one.of("scene.new")}
        assert len(set(one.ids())) == len(scenes) + 2


def has_selection(each: Receiver) -> bool:
    return bool(each.of("selection.made"))


def as_regressed(found: Comparison) -> Comparison:
    """Let the class that only one side has be a regression: these logs are too few to prove it."""
    groups = tuple(
        row.model_copy(update={"outcome": "regressed"}) if row.group == "pedestrian" else row
        for row in found.groups
    )
    return found.model_copy(update={"groups": groups, "regressed": 1})


def mode(mode_id: str) -> ModeRow:
    return ModeRow(
        mode_id=mode_id,
        name="car",
        kind="only_predictive_dynamic",
        tracks=1,
        scenes=1,
        per_hour=1.0,
        earlier_per_hour=1.0,
        later_per_hour=None,
        first_ns=0,
        last_ns=0,
        vehicles=(),
        software_versions=(),
        examples=(ModeExample(scene_id="a/lidar/1", track_id=1, strength=0.5, rank=1),),
    )


class TestOnSqlite(OnSqlite, WebhooksContract):
    """By a file."""


class TestOnPostgres(OnPostgres, WebhooksContract):
    """By a server."""
