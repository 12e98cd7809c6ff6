"""Verdicts on any database: stored once, undone, of several reviewers, of the record seen."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from schemas.verdict import Verdict, VerdictRow
from service.curation.verdicts import (
    AgreementRequest,
    JudgeRequest,
    UndoRequest,
    VerdictsRequest,
)
from service.errors import NothingFoundError, UsageError
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World
from tests.contracts.store_contract import StoreContract


def judge(world: World, scene_id: str, verdict: str, **how: Any) -> VerdictRow:
    """Judge as Ann, under a key of its own."""
    how = {"reviewer": "ann", "key": f"k{world.ledger.verdicts.last()}", **how}
    return world.ledger.verdicts.judge(
        JudgeRequest(scene_id=scene_id, verdict=Verdict(verdict), **how)
    )


def digest_of(world: World, scene_id: str) -> str:
    """Return the digest of a scene's record."""
    stored = world.ledger.scene(scene_id)
    assert stored is not None
    return stored.sha256


def undo(world: World, **how: Any) -> VerdictRow:
    how = {"reviewer": "ann", "key": f"u{world.ledger.verdicts.last()}", **how}
    return world.ledger.verdicts.undo(UndoRequest(**how))


def counting(world: World, **of: Any) -> list[tuple[str, str]]:
    """Reviewer and verdict of what counts, oldest first."""
    rows = world.ledger.verdicts.page(VerdictsRequest(**of))
    return [(row.reviewer, row.verdict.value) for row in reversed(rows)]


class VerdictsContract(StoreContract):
    @pytest.fixture
    def scenes(self, world: World) -> list[str]:
        world.listed("a")
        world.mine_all()
        return world.ids()

    def test_a_verdict_is_numbered_and_keeps_what_was_seen(
        self, world: World, scenes: list[str]
    ) -> None:
        stored = judge(
            world,
            scenes[0],
            "supervised",
            track_id=0,
            cause="brief_stop",
            note="at the light",
            took_s=6.5,
        )
        assert stored.ordinal == 1
        assert stored.sha256 == digest_of(world, scenes[0])
        assert (stored.track_id, stored.cause, stored.note, stored.took_s) == (
            0,
            "brief_stop",
            "at the light",
            6.5,
        )
        assert (stored.is_current, stored.record) == (True, "current")
        assert stored.judged_s == world.clock.now_s
        (event,) = world.ledger.verdicts.since(0, 10)
        assert event.model_dump() == stored.model_dump(exclude={"is_current", "record"})

    def test_the_same_write_again_is_stored_once(self, world: World, scenes: list[str]) -> None:
        first = judge(world, scenes[0], "both", key="one")
        assert judge(world, scenes[0], "both", key="one") == first
        assert judge(world, scenes[0], "both", key="one", sha256=first.sha256) == first
        undone = undo(world, key="two")
        assert undo(world, key="two") == undone
        assert world.ledger.verdicts.last() == 2
        with pytest.raises(UsageError, match="another write"):
            judge(world, scenes[0], "neither", key="one")
        with pytest.raises(UsageError, match="another write"):
            judge(world, scenes[0], "both", key="two")
        with pytest.raises(UsageError, match="another write"):
            undo(world, key="one")

    def test_an_undo_restores_the_verdict_before(self, world: World, scenes: list[str]) -> None:
        judge(world, scenes[0], "both")
        judge(world, scenes[1], "neither")
        judge(world, scenes[0], "supervised")
        assert counting(world) == [("ann", "neither"), ("ann", "supervised")]
        assert undo(world).scene_id == scenes[0]
        assert counting(world) == [("ann", "both"), ("ann", "neither")]
        assert undo(world, scene_id=scenes[0]).verdict is Verdict.WITHDRAWN
        assert counting(world) == [("ann", "neither")]
        undo(world)
        with pytest.raises(NothingFoundError, match="no verdict to undo"):
            undo(world)
        events = world.ledger.verdicts.since(0, 100)
        assert [event.ordinal for event in events] == [1, 2, 3, 4, 5, 6]

    def test_a_scene_and_its_track_are_judged_apart(self, world: World, scenes: list[str]) -> None:
        judge(world, scenes[0], "both")
        judge(world, scenes[0], "neither", track_id=0)
        assert len(counting(world)) == 2
        undo(world, scene_id=scenes[0])
        assert counting(world) == [("ann", "neither")]

    def test_reviewers_do_not_replace_each_other(self, world: World, scenes: list[str]) -> None:
        judge(world, scenes[0], "both")
        judge(world, scenes[0], "supervised", reviewer="bob")
        undo(world)
        assert counting(world) == [("bob", "supervised")]
        assert counting(world, reviewer="ann") == []

    def test_what_never_existed_is_refused_with_a_sentence(
        self, world: World, scenes: list[str]
    ) -> None:
        with pytest.raises(NothingFoundError, match="never a scene 'a/lidar/7'"):
            judge(world, "a/lidar/7", "both")
        with pytest.raises(NothingFoundError, match="never a scene 'a/lidar/7'"):
            judge(world, "a/lidar/7", "both", sha256="0" * 64)
        with pytest.raises(NothingFoundError, match="never had the record"):
            judge(world, scenes[0], "both", sha256="0" * 64)
        with pytest.raises(NothingFoundError, match="no track 10"):
            judge(world, scenes[0], "both", track_id=9)
        with pytest.raises(NothingFoundError, match="never a scene 'x'"):
            judge(world, scenes[0], "duplicate", duplicate_of="x")
        with pytest.raises(UsageError, match="not both"):
            judge(world, scenes[0], "both", duplicate_of=scenes[1])
        with pytest.raises(UsageError, match="no duplicate of itself"):
            judge(world, scenes[0], "duplicate", duplicate_of=scenes[0])
        with pytest.raises(UsageError, match="undo it"):
            judge(world, scenes[0], "withdrawn")
        assert world.ledger.verdicts.last() == 0

    def test_a_scene_mined_again_keeps_the_verdict_of_its_earlier_record(
        self, world: World, scenes: list[str]
    ) -> None:
        seen = judge(world, scenes[0], "supervised")
        world.mine_all("p2")
        now = digest_of(world, scenes[0])
        assert now != seen.sha256
        (row,) = world.ledger.verdicts.page(VerdictsRequest(scene_id=scenes[0]))
        assert (row.is_current, row.record) == (True, "replaced")
        stale = judge(world, scenes[0], "both", sha256=seen.sha256, reviewer="bob")
        assert (stale.sha256, stale.record) == (seen.sha256, "replaced")
        fresh = judge(world, scenes[0], "neither")
        assert (fresh.sha256, fresh.record) == (now, "current")
        summary = world.ledger.verdicts.summaries([(scenes[0], now)], reviewer="ann")
        assert summary[scenes[0]].text == "neither"
        assert (summary[scenes[0]].earlier, summary[scenes[0]].mine) == (2, Verdict.NEITHER)

    def test_a_withdrawn_scene_is_judged_and_marked(self, world: World, scenes: list[str]) -> None:
        world.listed("b")
        stored = judge(world, scenes[0], "neither")
        assert stored.record == "withdrawn"
        assert counting(world) == [("ann", "neither")]

    def test_pages_of_verdicts_go_back_in_time(self, world: World, scenes: list[str]) -> None:
        for scene_id in scenes[:5]:
            judge(world, scene_id, "both")
        first = world.ledger.verdicts.page(VerdictsRequest(most=2))
        assert [row.ordinal for row in first] == [5, 4, 3]  # one more than was asked
        last = world.ledger.verdicts.page(VerdictsRequest(most=3, before=4))
        assert [row.ordinal for row in last] == [3, 2, 1]

    def test_agreement_is_of_all_or_of_a_selection(self, world: World, scenes: list[str]) -> None:
        world.ledger.selections.save("week", budget=2, scenes=world.ledger.ranking(most=2))
        chosen = [row.scene_id for row in world.ledger.ranking(most=2)]
        other = next(each for each in scenes if each not in chosen)
        judge(world, chosen[0], "supervised", took_s=4)
        judge(world, other, "neither", took_s=10)
        judge(world, chosen[0], "neither", reviewer="bob")
        whole = world.ledger.verdicts.agreement(AgreementRequest())
        assert (whole.budget, whole.scenes, whole.conflicting) == (None, 2, 1)
        assert (whole.precision.right, whole.precision.judged) == (1, 2)
        week = world.ledger.verdicts.agreement(AgreementRequest(selection="week"))
        assert (week.budget, week.scenes, week.conflicting) == (2, 1, 1)
        assert [(pace.reviewer, pace.scenes, pace.median_s) for pace in week.pace] == [
            ("ann", 1, 4),
            ("bob", 1, None),
        ]
        with pytest.raises(NothingFoundError, match="no selection 'none'"):
            world.ledger.verdicts.agreement(AgreementRequest(selection="none"))

    def test_the_cursor_of_the_outbox_moves_over_the_events(
        self, world: World, scenes: list[str]
    ) -> None:
        judge(world, scenes[0], "both")
        undo(world)
        assert [each.ordinal for each in world.ledger.verdicts.unpublished(10)] == [1, 2]
        world.ledger.verdicts.mark_published(1)
        assert [each.ordinal for each in world.ledger.verdicts.unpublished(10)] == [2]

    def test_writers_at_once_lose_nothing(self, world: World, scenes: list[str]) -> None:
        def write(number: int) -> VerdictRow:
            return judge(
                world,
                scenes[number % len(scenes)],
                "both" if number % 2 else "neither",
                reviewer=f"r{number % 4}",
                key=f"key-{number}",
            )

        with ThreadPoolExecutor(8) as pool:
            stored = list(pool.map(write, [*range(40), *range(40)]))
        assert sorted({row.ordinal for row in stored}) == list(range(1, 41))
        assert world.ledger.verdicts.last() == 40

    def test_what_is_stored_outlives_the_process(self, world: World, scenes: list[str]) -> None:
        judge(world, scenes[0], "both")
        again = World.on(self.make_store())
        assert counting(again) == [("ann", "both")]
        again.store.close()


class TestVerdictsOnSqlite(OnSqlite, VerdictsContract):
    pass


@pytest.mark.integration
class TestVerdictsOnPostgres(OnPostgres, VerdictsContract):
    pass
