"""The best distinct scenes under a budget, and strategies by name."""

from collections.abc import Iterable, Iterator, Sequence

import pytest

from schemas.attribution import Attribution, Wrong
from schemas.events import TrackSummary
from schemas.score import MIN_REPORTED_STRENGTH
from service.curation.candidates import Candidate, Choice
from service.curation.ranking import RankedScene, has_reason
from service.curation.selection import Selection, left_out, why_no_reason
from service.curation.strategies import catalogue
from service.curation.strategies.catalogue import STRATEGIES, Strategy
from service.errors import UsageError
from tests.factories import track_record


def row(
    rank: int,
    score: float,
    *,
    twin_of: str | None = None,
    wrong: Wrong | None = Wrong.SUPERVISED,
    strength: float | None = None,
) -> RankedScene:
    strength = score if strength is None else strength
    attribution = wrong and Attribution(
        wrong=wrong, supervised=0.6, selfsupervised=0.4, both=0.0, neither=0.0
    )
    track = track_record(strength=strength, attribution=attribution)
    return RankedScene(
        rank=rank,
        scene_id=f"a/lidar/{rank}",
        log_id="a",
        start_ns=rank,
        end_ns=rank + 1,
        score=score,
        reasons=(),
        tracks=(TrackSummary.of(track),) if strength >= MIN_REPORTED_STRENGTH else (),
        twin_of=twin_of,
        sha256="0" * 64,
    )


def select(
    ranking: Iterable[RankedScene], *, budget: int, strategy: str = catalogue.DEFAULT
) -> list[RankedScene]:
    candidates = (Candidate(scene) for scene in ranking)
    return [each.scene for each in catalogue.select(candidates, budget=budget, strategy=strategy)]


RANKING = [
    row(1, 0.9),
    row(2, 0.8, twin_of="a/lidar/1"),
    row(3, 0.7),
    row(4, 0.6, wrong=Wrong.SELFSUPERVISED),
    row(5, 0.2, wrong=Wrong.BOTH),
    row(6, 0.07, strength=0.04),
    row(7, 0.02),
    row(8, 0.0),
]


def test_the_best_are_taken_and_twins_left_out() -> None:
    assert [scene.rank for scene in select(RANKING, budget=2)] == [1, 3]


def test_a_budget_is_filled_with_twins_and_never_with_what_has_no_reason() -> None:
    assert [scene.rank for scene in select(RANKING, budget=3)] == [1, 3, 5]
    assert [scene.rank for scene in select(RANKING, budget=4)] == [1, 2, 3, 5]
    assert [scene.rank for scene in select(RANKING, budget=50)] == [1, 2, 3, 5]


def test_a_strong_track_without_an_attribution_is_a_reason() -> None:
    assert has_reason(row(1, 0.5, wrong=None))
    assert not has_reason(row(1, 0.5, wrong=Wrong.NEITHER))


def test_the_ranking_is_read_no_further_than_the_choice_needs() -> None:
    read = []

    def reading() -> Iterator[RankedScene]:
        for scene in RANKING:
            read.append(scene.rank)
            yield scene

    select(reading(), budget=2)
    assert read == [1, 2, 3]
    read.clear()
    select(reading(), budget=50)
    assert read == [1, 2, 3, 4, 5, 6, 7]


def test_nothing_can_be_selected_from_nothing() -> None:
    assert select([], budget=5) == []


@pytest.mark.parametrize("budget", [0, -3])
def test_a_budget_below_one_is_refused(budget: int) -> None:
    with pytest.raises(ValueError, match=f"at least 1 scene, got {budget}"):
        select(RANKING, budget=budget)


def test_what_a_selection_passed_over_is_sorted_by_why() -> None:
    def passed(budget: int) -> tuple[list[int], list[int]]:
        chosen = tuple(select(RANKING, budget=budget))
        found = left_out(RANKING, Selection(name="week", budget=budget, scenes=chosen))
        return [each.rank for each in found.twins], [each.rank for each in found.without]

    assert passed(1) == ([], []), "the twin comes after the last one selected"
    assert passed(2) == ([2], [])
    assert passed(3) == ([2], [4])
    assert passed(50) == ([], [4, 6, 7, 8])


def test_why_a_scene_has_no_reason_is_told() -> None:
    assert why_no_reason(RANKING[3]) == "no strong track on which the supervised stream errs"
    assert why_no_reason(RANKING[5]) == "no track is strong enough for a reason"
    assert why_no_reason(RANKING[7]) == "nothing contradicts, or it was not judged"


def last_first(
    candidates: Iterable[Candidate], *, budget: int, taken: Sequence[Candidate]
) -> list[Choice]:
    last = [each.scene for each in candidates][::-1][:budget]
    return [Choice(scene=scene, gain=0.0, why="late") for scene in last]


def test_one_row_makes_a_strategy(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="no selection strategy 'last-first'; known: best-dist"):
        select(RANKING, budget=2, strategy="last-first")
    row = Strategy("last-first", last_first, "The least contradicting scenes.")
    monkeypatch.setattr(catalogue, "STRATEGIES", (*STRATEGIES, row))
    assert [scene.rank for scene in select(RANKING, budget=2, strategy="last-first")] == [8, 7]
    assert [scene.rank for scene in select(RANKING, budget=2)] == [1, 3], "the default stays"
