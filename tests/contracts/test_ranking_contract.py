"""The order of scenes, and which are neighbours of a better one, as any database gives it."""

import random

import pytest

from schemas.arrays import NS_PER_S
from schemas.canonical import sha256
from schemas.contradiction import SceneState
from schemas.events import TrackSummary
from schemas.score import MIN_REPORTED_STRENGTH, SceneScore
from schemas.transport.wire import encode_scene_score
from service.curation.ranking import RankedScene
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


def scene(
    number: int,
    score: float,
    *,
    log_id: str = "a",
    topic: str = "/lidar",
    state: SceneState = SceneState.SCORED,
    after_gap_s: float = 0.0,
) -> SceneScore:
    """The scene of a 2 s cell, 1.9 s long, of a 10 Hz lidar."""
    start_ns = START_NS + number * 2 * NS_PER_S + int(after_gap_s * NS_PER_S)
    return score_of(log_id, start_ns, score=score, topic=topic, state=state)


def rank(world: World, *scores: SceneScore) -> list[RankedScene]:
    """Commit these scenes, one shard for each log and lidar, and read the ranking."""
    lidars = {
        log: sorted({s.lidar_topic for s in scores if s.log_id == log}) for log in logs_of(scores)
    }
    world.listed(*lidars)
    for _ in lidars:
        lease = world.plan_lease()
        log_id = lease.recording.log_id
        shards = tuple(
            shard_of(log_id, 0, of=1, topic=topic, cells=36_000) for topic in lidars[log_id]
        )
        plan = plan_of(log_id, shards=1).model_copy(update={"shards": shards})
        assert world.commit_plan(lease, plan=plan).ok
    for _ in [topic for topics in lidars.values() for topic in topics]:
        mine = world.mine_lease()
        of = (mine.shard.log_id, mine.shard.lidar.topic)
        encoded = [encode_scene_score(s) for s in scores if (s.log_id, s.lidar_topic) == of]
        records = {sha256(record): record for record in encoded}
        assert world.ledger.commit(shard_commit(mine, records), records).ok
    return world.ledger.ranking()


def logs_of(scores: tuple[SceneScore, ...]) -> list[str]:
    return sorted({score.log_id for score in scores})


def seconds(row: RankedScene) -> int:
    return (row.start_ns - START_NS) // NS_PER_S


def twins(ranking: list[RankedScene]) -> dict[int, int | None]:
    """Start of each scene to that of the scene it is a twin of, both in seconds."""
    by_id = {row.scene_id: seconds(row) for row in ranking}
    return {seconds(row): None if row.twin_of is None else by_id[row.twin_of] for row in ranking}


class RankingContract(StoreContract):
    def test_the_best_scene_is_first_and_ranks_count_from_one(self, world: World) -> None:
        ranking = rank(world, scene(0, 0.1), scene(5, 0.9), scene(9, 0.5))
        assert [(row.rank, row.score) for row in ranking] == [(1, 0.9), (2, 0.5), (3, 0.1)]
        assert world.ledger.ranking(most=2) == ranking[:2]

    def test_a_row_has_exactly_the_columns_that_are_printed(self, world: World) -> None:
        (row,) = rank(world, one := scene(0, 0.5))
        assert row.model_dump() == {
            "rank": 1,
            "scene_id": one.scene_id,
            "log_id": "a",
            "start_ns": one.start_ns,
            "end_ns": one.end_ns,
            "score": 0.5,
            "reasons": tuple(each.headline for each in one.reasons),
            "tracks": (TrackSummary.of(one.tracks[0]).model_dump(),),
            "twin_of": None,
            "sha256": sha256(encode_scene_score(one)),
        }

    @pytest.mark.parametrize("state", [SceneState.TOO_SHORT, SceneState.ODOMETRY_LOST])
    def test_what_could_not_be_judged_is_listed_last(self, world: World, state: SceneState) -> None:
        ranking = rank(world, scene(0, 0.0, state=state), scene(5, 0.0), scene(9, 0.3))
        assert [seconds(row) for row in ranking] == [18, 10, 0]

    def test_equal_scores_are_ordered_by_log_as_bytes_and_time(self, world: World) -> None:
        logs = ["B", "a", "a-b", "a/b", "aB", "ab", "Ä", "é"]  # a locale would sort otherwise
        ranking = rank(world, *(scene(n, 0.5, log_id=log) for log in logs[::-1] for n in (5, 0)))
        assert [(row.log_id, seconds(row)) for row in ranking] == [
            (log, at) for log in sorted(logs) for at in (0, 10)
        ]

    def test_a_neighbour_of_a_better_scene_is_its_twin(self, world: World) -> None:
        ranking = rank(world, scene(0, 0.2), scene(1, 0.9), scene(2, 0.5))
        assert twins(ranking) == {2: None, 4: 2, 0: 2}

    def test_a_scene_between_two_better_ones_is_the_twin_of_the_best(self, world: World) -> None:
        ranking = rank(world, scene(0, 0.7), scene(1, 0.1), scene(2, 0.8))
        assert twins(ranking) == {4: None, 0: None, 2: 4}

    def test_no_scene_is_the_twin_of_a_twin(self, world: World) -> None:
        ranking = rank(world, *(scene(n, 0.9 - n / 10) for n in range(4)))
        assert twins(ranking) == {0: None, 2: 0, 4: None, 6: 4}

    def test_a_neighbour_that_shows_another_thing_is_no_twin(self, world: World) -> None:
        other = scene(1, 0.5)
        bus = other.tracks[0].model_copy(update={"class_name": "bus"})
        ranking = rank(world, scene(0, 0.9), other.model_copy(update={"tracks": (bus,)}))
        assert twins(ranking) == {0: None, 2: None}

    def test_a_row_lists_no_more_than_the_five_strongest_tracks(self, world: World) -> None:
        many = scene(0, 0.9)
        tracks = tuple(
            many.tracks[0].model_copy(update={"track_id": number, "strength": 0.9 - number / 8})
            for number in range(8)
        )
        (row,) = rank(world, many.model_copy(update={"tracks": tracks}))
        assert [each.track_id for each in row.tracks] == [0, 1, 2, 3, 4]

    def test_of_two_equal_neighbours_the_earlier_one_stays(self, world: World) -> None:
        assert twins(rank(world, scene(1, 0.5), scene(0, 0.5))) == {0: None, 2: 0}

    def test_scenes_without_contradiction_are_nobodys_better_neighbour(self, world: World) -> None:
        unjudged = scene(2, 0.0, state=SceneState.TOO_SHORT)
        assert set(twins(rank(world, scene(0, 0.0), scene(1, 0.0), unjudged)).values()) == {None}

    @pytest.mark.parametrize(("gap_s", "is_twin"), [(0.8, True), (0.9, False)])
    def test_a_pause_of_a_second_makes_scenes_distinct(
        self, world: World, gap_s: float, is_twin: bool
    ) -> None:
        _, second = rank(world, scene(0, 0.9), scene(1, 0.5, after_gap_s=gap_s))
        assert (second.twin_of is not None) == is_twin

    def test_another_log_or_lidar_at_the_same_time_is_no_twin(self, world: World) -> None:
        others = scene(1, 0.5, log_id="b"), scene(1, 0.4, topic="/rear")
        assert [row.twin_of for row in rank(world, scene(0, 0.9), *others)] == [None] * 3

    def test_nothing_ranks_as_nothing(self, world: World) -> None:
        assert world.ledger.ranking() == []
        assert world.ledger.proposals.select(budget=3) == []

    def test_a_scene_that_is_not_current_has_no_rank_and_no_twin(self, world: World) -> None:
        rank(world, scene(0, 0.9), scene(1, 0.5), scene(1, 0.2, log_id="b"))
        world.listed("b")
        assert [row.log_id for row in world.ledger.ranking()] == ["b"]

    def test_more_scenes_than_are_held_at_once_are_ranked_as_a_plain_sort_would(
        self, world: World
    ) -> None:
        dice = random.Random(1)  # noqa: S311 (a test's dice)
        scores = [
            scene(
                number,
                score := dice.choice([0.0, 0.25, 0.5, round(dice.random(), 6)]),
                log_id=log,
                after_gap_s=dice.choice([0.0, 0.85, 0.95]),
                state=SceneState.SCORED if score else dice.choice(list(SceneState)),
            )
            for log in ("a", "b", "c")
            for number in range(0, 1000, 2 if log == "c" else 1)
            if dice.random() < 0.6
        ]
        ranking = rank(world, *scores)
        assert len(ranking) == len(scores) > 1200
        by_id = {score.scene_id: score for score in scores}
        ordered = sorted(
            scores, key=lambda s: (s.state != "scored", -s.score, s.log_id, s.start_ns)
        )
        assert [row.scene_id for row in ranking] == [score.scene_id for score in ordered]
        place = {score.scene_id: number for number, score in enumerate(ordered)}
        kept: set[str] = set()
        for row in ranking:
            better = [
                other.scene_id
                for other in scores
                if other.log_id == row.log_id
                and other.scene_id in kept
                and other.start_ns - by_id[row.scene_id].end_ns < NS_PER_S
                and by_id[row.scene_id].start_ns - other.end_ns < NS_PER_S
            ]
            expected = min(better, key=place.__getitem__, default=None)
            assert row.twin_of == (expected if row.score >= MIN_REPORTED_STRENGTH else None)
            if row.twin_of is None and row.score >= MIN_REPORTED_STRENGTH:
                kept.add(row.scene_id)
        with_reason = [row for row in ranking if row.score >= MIN_REPORTED_STRENGTH]
        distinct = [row for row in with_reason if row.twin_of is None]
        assert len(distinct) < len(with_reason)
        assert world.ledger.proposals.select(budget=40) == distinct[:40]
        assert world.ledger.proposals.select(budget=4000) == with_reason


class TestRankingOnSqlite(OnSqlite, RankingContract):
    pass


@pytest.mark.integration
class TestRankingOnPostgres(OnPostgres, RankingContract):
    pass
