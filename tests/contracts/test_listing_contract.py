"""Pages of the listing on any database: every filter and order, and pages that stay."""

import random
from collections.abc import Sequence
from typing import Any

import pytest
from sqlalchemy import update

from schemas.arrays import NS_PER_S
from schemas.attribution import Attribution, Wrong
from schemas.canonical import sha256
from schemas.contradiction import SceneState
from schemas.score import Producers, SceneScore
from schemas.transport.wire import encode_scene_score
from schemas.verdict import Verdict
from service.curation.activity import ActivityRequest
from service.curation.listing import ListedScene, ScenesReply, ScenesRequest
from service.curation.verdicts import JudgeRequest, UndoRequest
from service.errors import NothingFoundError, RecordDamagedError, UsageError
from service.store.tables import SCENES
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import (
    START_NS,
    World,
    plan_of,
    score_of,
    shard_commit,
    shard_of,
)
from tests.contracts.store_contract import StoreContract
from tests.factories import track_record


def attributed(wrong: Wrong) -> Attribution:
    chances = {each.value: 0.1 for each in Wrong} | {wrong.value: 0.7}
    return Attribution(wrong=wrong, **chances)


def scene(number: int, score: float = 0.5, **how: Any) -> SceneScore:
    """The scene of a 2 s cell, with one strong track by default."""
    start_ns = START_NS + number * 2 * NS_PER_S
    tracks = how.pop("tracks", (track_record(strength=0.5),))
    log_id, state = how.pop("log_id", "a"), how.pop("state", SceneState.SCORED)
    reasons = how.pop("reasons", ("a headline",))
    made = score_of(log_id, start_ns, score=score, state=state, reasons=reasons)
    return made.model_copy(update={"tracks": tracks, **how})


def commit(world: World, *scores: SceneScore) -> None:
    """Commit these scenes, one shard for each log, in a bucket of these logs alone."""
    logs = sorted({score.log_id for score in scores})
    world.listed(*logs)
    for _ in logs:
        lease = world.plan_lease()
        log_id = lease.recording.log_id
        shards = (shard_of(log_id, 0, of=1, cells=36_000),)
        plan = plan_of(log_id, shards=1).model_copy(update={"shards": shards})
        assert world.commit_plan(lease, plan=plan).ok
    for _ in logs:
        mine = world.mine_lease()
        encoded = [encode_scene_score(s) for s in scores if s.log_id == mine.shard.log_id]
        records = {sha256(record): record for record in encoded}
        assert world.ledger.commit(shard_commit(mine, records), records).ok


def ask(world: World, **how: Any) -> ScenesReply:
    return world.ledger.listing(ScenesRequest(**how))


def numbers(rows: Sequence[ListedScene]) -> list[int]:
    """Cell of each scene."""
    return [(row.start_ns - START_NS) // NS_PER_S // 2 for row in rows]


def found(world: World, **how: Any) -> list[int]:
    """Cells of the scenes that pass, by time; their number is the total."""
    reply = ask(world, sort="earliest", **how)
    assert reply.total == len(reply.rows)
    return numbers(reply.rows)


def judge(world: World, scene_id: str, verdict: str = "both", **how: Any) -> None:
    how = {"reviewer": "ann", "key": f"k{world.ledger.verdicts.last()}", **how}
    world.ledger.verdicts.judge(JudgeRequest(scene_id=scene_id, verdict=Verdict(verdict), **how))


class ListingContract(StoreContract):
    def test_orders(self, world: World) -> None:
        lost = SceneState.ODOMETRY_LOST
        commit(world, scene(3, 0.2), scene(1, 0.9), scene(2, 0.0, state=lost), scene(0, 0.0))
        assert numbers(ask(world).rows) == [1, 3, 0, 2]
        assert numbers(ask(world, sort="earliest").rows) == [0, 1, 2, 3]
        assert numbers(ask(world, sort="latest").rows) == [3, 2, 1, 0]
        assert numbers(ask(world, sort="newest").rows) == [0, 2, 1, 3]
        rows = ask(world, sort="newest").rows
        judge(world, rows[2].scene_id)
        judge(world, rows[0].scene_id)
        assert numbers(ask(world, sort="judged").rows) == [0, 1]

    def test_a_row_has_what_a_card_shows(self, world: World) -> None:
        track = track_record(strength=0.4, attribution=attributed(Wrong.BOTH))
        commit(world, one := scene(0, 0.5, log_id="fleet/car/a", tracks=(track,)))
        (row,) = ask(world).rows
        assert row.scene_id == one.scene_id
        assert row.name == "a@2023-11-14T22:13:20.0"
        assert (row.score, row.state, row.headline) == (0.5, "scored", "a headline")
        assert (row.kind, row.class_name, row.strength) == (track.kind, track.class_name, 0.4)
        assert (row.wrong, [each.track_id for each in row.tracks]) == (Wrong.BOTH, [0])
        assert row.sha256 == sha256(encode_scene_score(one))
        assert row.verdicts.judged == 0

    @pytest.mark.parametrize("order", ["score", "newest", "earliest", "latest", "judged"])
    def test_pages_follow_each_other_without_gap_or_repeat(self, world: World, order: str) -> None:
        dice = random.Random(1)  # noqa: S311 (a test's dice)
        commit(world, *(scene(n, dice.choice([0.0, 0.25, 0.5])) for n in range(60)))
        for row in ask(world, most=60).rows[:40]:
            judge(world, row.scene_id)
        whole = ask(world, sort=order, most=200)
        assert whole.next == ""
        seen: list[str] = []
        after = ""
        while True:
            part = ask(world, sort=order, most=7, after=after)
            assert part.total == whole.total == (40 if order == "judged" else 60)
            seen += [row.scene_id for row in part.rows]
            if not part.next:
                break
            after = part.next
        assert seen == [row.scene_id for row in whole.rows]

    def test_a_page_stays_while_scenes_arrive(self, world: World) -> None:
        commit(world, *(scene(n, 0.5 - n / 100) for n in range(10)))
        first = ask(world, most=5)
        world.listed("a", "b")
        commit_more(world, scene(3, 0.99, log_id="b"), scene(4, 0.01, log_id="b"))
        second = ask(world, most=5, after=first.next)
        assert numbers(second.rows) == [5, 6, 7, 8, 9]
        assert second.total == 12
        assert numbers(ask(world, most=5, after=second.next).rows) == [4]

    def test_filters(self, world: World) -> None:
        wrong = track_record(strength=0.4, attribution=attributed(Wrong.BOTH), class_name="bus")
        weak = track_record(strength=0.01, class_name="tram")
        other = track_record(strength=0.3, kind="only_semantic_dynamic", class_name="car")
        made_by = Producers(supervised="net@2", selfsupervised="r@1", pipeline_version="p1")
        commit(
            world,
            scene(0, 0.9, vehicle="car-1", tracks=(wrong, weak)),
            scene(1, 0.3, vehicle="car-2", software_version="2.1", tracks=(other,)),
            scene(2, 0.0, state=SceneState.TOO_SHORT, vehicle="car-2", tracks=()),
            scene(3, 0.4, log_id="b/night", producers=made_by, tracks=(other, wrong)),
        )
        assert found(world) == [0, 1, 2, 3]
        assert found(world, vehicle="car-2") == [1, 2]
        assert found(world, vehicle="car-3") == []
        assert found(world, software_version="2.1") == [1]
        assert found(world, kind="only_semantic_dynamic") == [1, 3]
        assert found(world, class_name="bus") == [0, 3]
        assert found(world, class_name="tram") == []
        assert found(world, wrong="both") == [0, 3]
        assert found(world, mode="net") == found(world, mode="net@2") == [3]
        assert found(world, mode="ne") == []
        assert found(world, log="b/*") == found(world, log="*ight") == [3]
        assert found(world, log="B/*") == []
        assert found(world, since_ns=START_NS + 2 * NS_PER_S, until_ns=START_NS + 6 * NS_PER_S) == [
            1,
            2,
        ]
        assert found(world, min_score=0.3) == [0, 1, 3]
        assert found(world, max_score=0.3) == [1, 2]
        assert found(world, min_score=0.35, vehicle="car-1", class_name="bus") == [0]

    def test_search_finds_parts_of_names_and_headlines_in_any_case(self, world: World) -> None:
        commit(
            world,
            scene(0, reasons=("Pedestrian 100% static", "a second one")),
            scene(1, reasons=("Fußgänger_x",), log_id="night/ride"),
        )
        assert found(world, text="pedestrian 100%") == [0]
        assert found(world, text="SECOND") == [0]
        assert found(world, text="100_") == []  # no pattern
        assert found(world, text="fussgänger_") == [1]
        assert found(world, text="night/ride/lidar") == [1]
        assert numbers(ask(world, text="a").rows) == [0, 1]
        assert numbers(ask(world, text="e", sort="latest", most=1).rows) == [1]
        (row,) = ask(world, text="ride@2023-11-14T22:13:22.0").rows
        assert row.log_id == "night/ride"
        assert ask(world, text="ide@2023-11-14T22:13:22.0").rows == ()
        assert ask(world, text="ride@2023-11-14T22:13:22.1").rows == ()

    def test_filters_by_verdict(self, world: World) -> None:
        commit(world, *(scene(n) for n in range(5)))
        ids = [row.scene_id for row in ask(world, sort="earliest").rows]
        judge(world, ids[0])
        judge(world, ids[1], reviewer="bob")
        judge(world, ids[2], track_id=0)
        judge(world, ids[3])
        world.ledger.verdicts.undo(UndoRequest(reviewer="ann", key="undone"))
        assert found(world, judged="yes") == [0, 1, 2]
        assert found(world, judged="no") == [3, 4]
        assert found(world, judged="mine", reviewer="ann") == [0, 2]
        assert found(world, judged="not_mine", reviewer="ann") == [1, 3, 4]
        assert found(world, judged="not_mine") == [0, 1, 2, 3, 4]
        rows = ask(world, sort="earliest", reviewer="ann").rows
        assert [row.verdicts.mine for row in rows] == [Verdict.BOTH, None, None, None, None]
        assert [row.verdicts.text for row in rows] == ["both", "both", "tracks", "", ""]

    def test_a_scene_mined_again_is_not_judged_and_says_that_it_was(self, world: World) -> None:
        world.listed("a")
        world.mine_all()
        first = ask(world, sort="earliest").rows[0]
        judge(world, first.scene_id)
        world.mine_all("p2")
        again = ask(world, sort="earliest").rows[0]
        assert (again.scene_id, again.verdicts.judged, again.verdicts.earlier) == (
            first.scene_id,
            0,
            1,
        )
        assert ask(world, judged="yes").total == 0

    def test_only_current_scenes_are_listed_and_their_verdicts_return_with_them(
        self, world: World
    ) -> None:
        world.listed("a", "b")
        world.mine_all()
        ids = {row.scene_id for row in ask(world, most=200).rows}
        assert ids == set(world.ids())
        judged = min(ids)
        judge(world, judged)
        world.listed("b")
        assert {row.scene_id for row in ask(world, most=200).rows} == set(world.ids())
        assert ask(world, judged="yes").total == 0
        assert ask(world, text=judged).total == 0
        world.listed("a", "b")
        world.mine_all()
        assert {row.scene_id for row in ask(world, most=200).rows} == set(world.ids()) == ids
        assert [row.scene_id for row in ask(world, judged="yes").rows] == [judged]

    def test_a_selection_is_looked_through(self, world: World) -> None:
        commit(world, *(scene(n, n / 10) for n in range(6)))
        world.ledger.selections.save("best", budget=3, scenes=world.ledger.ranking(most=3))
        assert numbers(ask(world, selection="best").rows) == [5, 4, 3]
        world.ledger.selections.save("none", budget=3, scenes=())
        assert ask(world, selection="none").total == 0
        with pytest.raises(NothingFoundError, match="no selection 'other'"):
            ask(world, selection="other")

    def test_a_damaged_record_is_left_out_of_its_page(self, world: World) -> None:
        commit(world, scene(0, 0.9), scene(1, 0.5))
        with world.store.writing() as connection:
            connection.execute(update(SCENES).where(SCENES.c.score > 0.7).values(record=b"{}"))
        assert numbers(ask(world).rows) == [1]
        with pytest.raises(RecordDamagedError, match="cannot be judged"):
            judge(world, f"a/lidar/{START_NS}")

    @pytest.mark.parametrize(
        "cursor", ["x", "ä", "W10=", "WyJuZXdlc3QiLCAxXQ==", "WyJzY29yZSIsICJhIiwgMSwgMl0="]
    )
    def test_a_cursor_that_is_none_is_refused(self, world: World, cursor: str) -> None:
        with pytest.raises(UsageError, match="begin with the first page"):
            ask(world, after=cursor)

    def test_choices_are_what_was_mined_and_the_causes(self, world: World) -> None:
        commit(world, scene(0, vehicle="x"), scene(1, vehicle="y", software_version="2"))
        choices = world.ledger.choices(causes=("my own",))
        assert choices.vehicles == ("x", "y")
        assert choices.software_versions == ("2", "unknown")
        assert choices.modes == ("s@1",)
        assert choices.causes[-1] == "my own"
        assert choices.reviewers == ()

    def test_activity_counts_scenes_where_recorded_and_verdicts_when_given(
        self, world: World
    ) -> None:
        hour = 1800  # scenes of two seconds
        commit(
            world,
            scene(0, 0.5, vehicle="x"),
            scene(1, 0.1, vehicle="y"),
            scene(hour, 0.0, vehicle="x", state=SceneState.TOO_SHORT, tracks=()),
        )
        rows = ask(world, sort="earliest").rows
        judge(world, rows[0].scene_id, "supervised")
        world.clock.now_s += 3600
        judge(world, rows[1].scene_id, "neither")
        judge(world, rows[2].scene_id, "unsure")
        found = world.ledger.activity(ActivityRequest(per="hour"))
        assert [(one.scenes, round(one.mean_score, 6)) for one in found.recorded] == [
            (2, 0.3),
            (1, 0.0),
        ]
        assert found.recorded[0].time_ms == START_NS // 10**6 // 3_600_000 * 3_600_000
        assert found.recorded[0].disagreement_rate == pytest.approx(0.05)
        assert [(one.verdicts, one.precision.share) for one in found.judged] == [(1, 1), (2, 0)]
        assert [(one.so_far.right, one.so_far.judged) for one in found.judged] == [(1, 1), (1, 2)]
        groups = {(one.by, one.group): (one.scenes, one.verdicts) for one in found.groups}
        assert groups == {
            ("vehicle", "x"): (2, 2),
            ("vehicle", "y"): (1, 1),
            ("version", "unknown"): (3, 3),
            ("kind", "only_predictive_dynamic"): (2, 2),
        }
        none = world.ledger.activity(ActivityRequest(until_ns=1))
        assert (none.recorded, none.judged, none.groups) == ((), (), ())


def commit_more(world: World, *scores: SceneScore) -> None:
    """Commit the scenes of one more log, which is listed."""
    lease = world.plan_lease()
    shards = (shard_of(lease.recording.log_id, 0, of=1, cells=36_000),)
    plan = plan_of(lease.recording.log_id, shards=1).model_copy(update={"shards": shards})
    assert world.commit_plan(lease, plan=plan).ok
    mine = world.mine_lease()
    records = {sha256(record): record for record in map(encode_scene_score, scores)}
    assert world.ledger.commit(shard_commit(mine, records), records).ok


class TestListingOnSqlite(OnSqlite, ListingContract):
    pass


@pytest.mark.integration
class TestListingOnPostgres(OnPostgres, ListingContract):
    pass
