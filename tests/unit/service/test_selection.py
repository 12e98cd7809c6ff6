"""The best distinct scenes under a budget, and strategies by name."""

from collections.abc import Iterable

import pytest

from service.curation.ranking import RankedScene
from service.curation.selection import LeftOut, Selection, left_out
from service.curation.strategies import catalogue
from service.curation.strategies.catalogue import STRATEGIES, Strategy, select
from service.errors import UsageError


def row(rank: int, score: float, *, twin_of: str | None = None) -> RankedScene:
    return RankedScene(
        rank=rank,
        scene_id=f"a/lidar/{rank}",
        log_id="a",
        start_ns=rank,
        end_ns=rank + 1,
        score=score,
        reasons=(),
        twin_of=twin_of,
        sha256="0" * 64,
    )


RANKING = [row(1, 0.9), row(2, 0.8, twin_of="a/lidar/1"), row(3, 0.7), row(4, 0.2), row(5, 0.0)]


def test_the_best_are_taken_and_twins_left_out() -> None:
    assert [scene.rank for scene in select(RANKING, budget=2)] == [1, 3]


def test_a_budget_is_not_filled_with_scenes_that_hold_no_contradiction() -> None:
    assert [scene.rank for scene in select(RANKING, budget=50)] == [1, 3, 4]


def test_nothing_can_be_selected_from_nothing() -> None:
    assert select([], budget=5) == []


@pytest.mark.parametrize("budget", [0, -3])
def test_a_budget_below_one_is_refused(budget: int) -> None:
    with pytest.raises(ValueError, match=f"at least 1 scene, got {budget}"):
        select(RANKING, budget=budget)


def test_what_a_selection_passed_over_is_counted_by_why() -> None:
    def passed(budget: int) -> LeftOut:
        chosen = tuple(select(RANKING, budget=budget))
        return left_out(RANKING, Selection(name="week", budget=budget, scenes=chosen))

    assert passed(1) == LeftOut(twins=0, without=0), "the twin comes after the last one selected"
    assert passed(2) == LeftOut(twins=1, without=0)
    assert passed(50) == LeftOut(twins=1, without=1)


def last_first(ranking: Iterable[RankedScene], *, budget: int) -> list[RankedScene]:
    return list(ranking)[::-1][:budget]


def test_one_row_makes_a_strategy(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="no selection strategy 'last-first'; known: best-dist"):
        select(RANKING, budget=2, strategy="last-first")
    row = Strategy("last-first", last_first, "The least contradicting scenes.")
    monkeypatch.setattr(catalogue, "STRATEGIES", (*STRATEGIES, row))
    assert [scene.rank for scene in select(RANKING, budget=2, strategy="last-first")] == [5, 4]
    assert [scene.rank for scene in select(RANKING, budget=2)] == [1, 3], "the default stays"
