"""The order of scenes, and which of them are neighbours of a better one."""

import random

import pytest

from schemas.contradiction import SceneState
from service.ranking import RankedInput, RankedScene, rank

SECOND_NS = 1_000_000_000


def scene(
    number: int,
    score: float,
    *,
    log_id: str = "a",
    topic: str = "/lidar",
    state: SceneState = SceneState.SCORED,
    after_gap_s: float = 0.0,
) -> RankedInput:
    """The scene of a 2 s cell, 1.9 s long, of a 10 Hz lidar."""
    start_ns = number * 2 * SECOND_NS + int(after_gap_s * SECOND_NS)
    return RankedInput(
        scene_id=f"{log_id}{topic}/{start_ns}",
        log_id=log_id,
        lidar_topic=topic,
        start_ns=start_ns,
        end_ns=start_ns + int(1.9 * SECOND_NS),
        score=score,
        state=state,
        reasons=("because",),
        sha256="0" * 64,
    )


def twins(ranking: list[RankedScene]) -> dict[int, int | None]:
    """Start of each scene to that of the scene it is a twin of, both in seconds."""

    def second(scene_id: str | None) -> int | None:
        return None if scene_id is None else int(scene_id.rsplit("/", 1)[1]) // SECOND_NS

    return {row.start_ns // SECOND_NS: second(row.twin_of) for row in ranking}


def test_the_best_scene_is_first_and_ranks_count_from_one() -> None:
    ranking = rank([scene(0, 0.1), scene(5, 0.9), scene(9, 0.5)])
    assert [(row.rank, row.score) for row in ranking] == [(1, 0.9), (2, 0.5), (3, 0.1)]


def test_a_row_has_exactly_the_columns_that_are_printed() -> None:
    (row,) = rank([scene(0, 0.5)])
    assert list(row.model_dump()) == [
        *("rank", "scene_id", "log_id", "start_ns", "end_ns", "score", "reasons", "twin_of"),
        "sha256",
    ]


def test_equal_scores_are_ordered_alike_whatever_the_order_they_come_in() -> None:
    scenes = [scene(n, 0.5, log_id=log) for n in range(0, 20, 2) for log in "abc"]
    shuffled = scenes.copy()
    random.Random(1).shuffle(shuffled)  # noqa: S311 (a test's dice)
    assert rank(shuffled) == rank(scenes)


@pytest.mark.parametrize("state", [SceneState.TOO_SHORT, SceneState.ODOMETRY_LOST])
def test_what_could_not_be_judged_is_listed_last(state: SceneState) -> None:
    ranking = rank([scene(0, 0.0, state=state), scene(5, 0.0), scene(9, 0.3)])
    assert [row.start_ns // SECOND_NS for row in ranking] == [18, 10, 0]


def test_a_neighbour_of_a_better_scene_is_its_twin() -> None:
    assert twins(rank([scene(0, 0.2), scene(1, 0.9), scene(2, 0.5)])) == {2: None, 4: 2, 0: 2}


def test_a_scene_between_two_better_ones_is_the_twin_of_the_best() -> None:
    assert twins(rank([scene(0, 0.7), scene(1, 0.1), scene(2, 0.8)])) == {4: None, 0: None, 2: 4}


def test_every_scene_with_a_better_neighbour_is_a_twin_down_a_whole_slope() -> None:
    assert twins(rank([scene(n, 0.9 - n / 10) for n in range(4)])) == {0: None, 2: 0, 4: 2, 6: 4}


def test_of_two_equal_neighbours_the_earlier_one_stays() -> None:
    assert twins(rank([scene(1, 0.5), scene(0, 0.5)])) == {0: None, 2: 0}


def test_scenes_without_contradiction_are_nobodys_better_neighbour() -> None:
    ranking = rank([scene(0, 0.0), scene(1, 0.0), scene(2, 0.0, state=SceneState.TOO_SHORT)])
    assert set(twins(ranking).values()) == {None}


def test_a_pause_of_a_second_makes_scenes_distinct() -> None:
    near = rank([scene(0, 0.9), scene(1, 0.5, after_gap_s=0.8)])
    far = rank([scene(0, 0.9), scene(1, 0.5, after_gap_s=0.9)])
    assert [row.twin_of is None for row in near] == [True, False]
    assert [row.twin_of is None for row in far] == [True, True]


def test_another_log_or_lidar_at_the_same_time_is_no_twin() -> None:
    ranking = rank([scene(0, 0.9), scene(1, 0.5, log_id="b"), scene(1, 0.4, topic="/rear")])
    assert [row.twin_of for row in ranking] == [None] * 3


def test_nothing_ranks_as_nothing() -> None:
    assert rank([]) == []
