"""Verdicts that count, Cohen's kappa, the interval of the precision, and the causes."""

import random
from typing import Any

import pytest

from schemas.verdict import GIVEN, Verdict, VerdictRow, VerdictSummary
from service.curation.verdicts import (
    CAUSES,
    agreement,
    cohens_kappa,
    need_cause,
    precision_of,
    standing_of,
    wilson,
)
from service.errors import UsageError
from tests.needed import needed

S, P, B, N, U, D, W = Verdict


def row(
    number: int, verdict: Verdict, *, reviewer: str = "ann", scene: str = "a", **how: Any
) -> VerdictRow:
    return VerdictRow(
        ordinal=number,
        key=f"k{number}",
        scene_id=f"{scene}/lidar/1",
        sha256=how.pop("sha256", "0"),
        reviewer=reviewer,
        verdict=verdict,
        judged_s=float(number),
        is_current=True,
        record="current",
        **how,
    )


@pytest.mark.parametrize(
    ("events", "counts"),
    [
        ([], None),
        ([S], 1),
        ([S, B], 2),
        ([S, W], None),
        ([S, B, W], 1),
        ([S, B, W, W], None),
        ([S, W, W, B], 4),
        ([S, B, W, N, W], 1),
    ],
)
def test_an_undo_restores_the_verdict_before(events: list[Verdict], counts: int | None) -> None:
    assert standing_of(enumerate(events, start=1)) == counts


def test_kappa_is_that_of_a_table_counted_by_hand() -> None:
    # 20 and 15 agreed, 5 and 10 not: observed 0.7; by chance 0.5 * 0.6 + 0.5 * 0.4 = 0.5.
    pairs = [(S, S)] * 20 + [(S, N)] * 5 + [(N, S)] * 10 + [(N, N)] * 15
    assert cohens_kappa(pairs) == pytest.approx(0.4)
    # Of three verdicts: observed 15 / 21; by chance (9 * 8 + 7 * 8 + 5 * 5) / 21^2 = 153 / 441.
    pairs = [(S, S)] * 7 + [(S, P)] * 2 + [(P, P)] * 5 + [(P, B)] * 2
    pairs += [(B, B)] * 3 + [(B, S), (B, P)]
    assert cohens_kappa(pairs) == pytest.approx((15 / 21 - 153 / 441) / (1 - 153 / 441))


def test_kappa_of_full_chance_and_opposite_agreement() -> None:
    assert cohens_kappa([(S, S), (N, N), (U, U)]) == 1
    assert cohens_kappa([(S, S), (S, N), (N, S), (N, N)]) == 0
    assert cohens_kappa([(S, N), (N, S)]) == -1


def test_kappa_is_scikit_learns() -> None:
    metrics = needed("sklearn.metrics", "the extra `workers`")
    dice = random.Random(1)  # noqa: S311 (a test's dice)
    for size in (2, 5, 50, 500):
        pairs = [(dice.choice(GIVEN), dice.choice(GIVEN[:4])) for _ in range(size)]
        expected = metrics.cohen_kappa_score([one for one, _ in pairs], [two for _, two in pairs])
        assert cohens_kappa(pairs) == pytest.approx(expected)


@pytest.mark.parametrize("pairs", [[], [(S, S)], [(D, D)] * 9])
def test_kappa_has_no_value_where_chance_explains_all(
    pairs: list[tuple[Verdict, Verdict]],
) -> None:
    assert cohens_kappa(pairs) is None


def test_the_interval_is_wilsons() -> None:
    assert wilson(0, 0) is None
    low, high = wilson(8, 10) or (0, 0)
    assert [low, high] == pytest.approx([0.4901625, 0.9433178])
    assert (wilson(0, 10) or (1, 1))[0] == 0
    assert (wilson(10, 10) or (0, 0))[1] == pytest.approx(1)
    found = precision_of(8, 10)
    assert (found.share, found.low, found.high) == (0.8, low, high)
    assert precision_of(0, 0).share is None


def test_a_scene_is_right_when_anybody_finds_the_supervised_stream_wrong() -> None:
    rows = [
        row(1, S),
        row(2, N, reviewer="bob"),
        row(3, U, scene="b"),
        row(4, D, scene="c"),
        row(5, P, scene="d"),
        row(6, B, scene="d", track_id=3),
        row(7, P, scene="e"),
        row(8, B, scene="e", sha256="1"),  # another record, which counts by itself
    ]
    found = agreement(rows, budget=50).precision
    assert (found.right, found.judged) == (3, 4)


def test_pace_pairs_and_conflicts() -> None:
    rows = [
        row(1, S, took_s=4),
        row(2, S, scene="b", took_s=6),
        row(3, N, scene="b", track_id=1, took_s=100),
        row(4, S, reviewer="bob"),
        row(5, B, reviewer="bob", scene="b"),
        row(6, U, reviewer="bob", scene="b", track_id=1),
        row(7, N, reviewer="cid", scene="z"),
    ]
    found = agreement(rows, budget=50)
    assert (found.budget, found.scenes) == (50, 3)
    assert [(p.reviewer, p.scenes, p.verdicts, p.median_s) for p in found.pace] == [
        ("ann", 2, 3, 6),
        ("bob", 2, 3, None),
        ("cid", 1, 1, None),
    ]
    assert [(p.one, p.other, p.items, p.agreed) for p in found.pairs] == [
        ("ann", "bob", 3, 1),
        ("ann", "cid", 0, 0),
        ("bob", "cid", 0, 0),
    ]
    assert found.pairs[0].kappa == pytest.approx((3 * 1 - 2) / (9 - 2))
    (conflict,) = found.conflicts  # that somebody is unsure is none
    assert (conflict.scene_id, conflict.track_id) == ("b/lidar/1", None)
    assert {each.reviewer for each in conflict.verdicts} == {"ann", "bob"}


def test_causes_are_those_of_the_taxonomy_and_the_users() -> None:
    need_cause("", ())
    need_cause(next(iter(CAUSES)), ())
    need_cause("wet lens", ("wet lens",))
    with pytest.raises(UsageError, match=r"choose of unseen_class, .*, wet lens"):
        need_cause("dry lens", ("wet lens",))


def test_a_summary_in_words() -> None:
    summary = VerdictSummary(supervised=2, unsure=1, tracks=1, earlier=4)
    assert (summary.text, summary.judged) == ("supervised 2, unsure, tracks", 4)
    assert VerdictSummary().text == ""
