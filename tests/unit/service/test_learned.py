"""Ranking by verdicts: the fit, the majority, the effect on unseen logs, and the refusals."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.attribution import Wrong
from schemas.events import RankedScene, TrackSummary
from schemas.verdict import Verdict, VerdictRow
from service.curation.learned import MIN_VERDICTS, chance_of, fit, judged_of, learned_ranking
from service.curation.learned_effect import average_precision, effect_of, folds_of
from service.errors import UsageError

DIGEST = "0" * 64


def scene(number: int, *, score: float = 0.5, logs: int = 12, **track: Any) -> RankedScene:
    strongest = {
        "kind": "only_semantic_dynamic",
        "strength": score,
        "wrong": Wrong.SUPERVISED,
        "chance": 0.7,
        "speed_m_per_s": 3.0,
        "centre_m": (10.0, 0.0, 0.0),
        "size_m": (2.0, 1.0, 1.5),
        "range_m": 10.0,
    } | track
    return RankedScene(
        rank=number + 1,
        scene_id=f"log-{number % logs}/lidar/{number}",
        log_id=f"log-{number % logs}",
        start_ns=number,
        end_ns=number + 1,
        score=score,
        tracks=(TrackSummary(track_id=0, first_ns=0, last_ns=1, stamp_ns=0, **strongest),),
        sha256=DIGEST,
    )


def verdict(of: RankedScene, value: Verdict, *, reviewer: str = "ann", **how: Any) -> VerdictRow:
    return VerdictRow(
        ordinal=of.rank,
        key=f"{reviewer}-{of.rank}",
        scene_id=of.scene_id,
        sha256=how.pop("sha256", DIGEST),
        reviewer=reviewer,
        verdict=value,
        judged_s=0.0,
        is_current=True,
        record="current",
        **how,
    )


def fleet(*, logs: int = 12) -> tuple[list[RankedScene], list[bool]]:
    """Scenes whose score is the same for cars, which are right, and for bushes, which are not."""
    scenes, right = [], []
    for number in range(80):
        is_car = number * 7 % 3 == 0
        how: dict[str, Any] = {"class_name": "car"} if is_car else {"class_name": "bush"}
        how |= {"size_m": (4.0, 2.0, 1.6)} if is_car else {"size_m": (0.6, 0.5, 0.7)}
        scenes.append(scene(number, score=0.9 - number / 200, logs=logs, **how))
        right.append(is_car)
    return scenes, right


def judged(scenes: list[RankedScene], right: list[bool], number: int) -> list[VerdictRow]:
    return [
        verdict(each, Verdict.SUPERVISED if is_right else Verdict.NEITHER)
        for each, is_right in list(zip(scenes, right, strict=True))[:number]
    ]


def test_a_fit_without_evidence_is_the_score_and_with_much_is_the_rate() -> None:
    none = fit(np.zeros((2, 1)), np.array([0.3, -2.0]), np.array([1.0, 0.0]))
    assert none == pytest.approx([0.0])
    ones, offset = np.ones((4000, 1)), np.full(4000, 2.0)
    is_right = (np.arange(4000) % 4 == 0).astype(float)
    weights = fit(ones, offset, is_right)
    assert chance_of(ones[:1], offset[:1], weights) == pytest.approx([0.25], abs=5e-3)
    few = fit(ones[:4], offset[:4], is_right[:4])
    assert math.log(1 / 3) < 2.0 + few[0] < 2.0


def test_a_fit_is_where_the_gradient_is_zero() -> None:
    rng = np.random.default_rng(1)
    features, offset = rng.normal(size=(50, 6)), rng.normal(size=50)
    is_right = (rng.random(50) < 0.4).astype(float)
    weights = fit(features, offset, is_right)

    def loss(at: NDArray[np.float64]) -> float:
        odds = offset + features @ at
        return float(np.sum(np.logaddexp(0, odds) - is_right * odds) + at @ at)

    for step in 1e-3 * np.eye(6):
        assert loss(weights) < min(loss(weights + step), loss(weights - step))


def test_the_majority_of_reviewers_decides_and_a_tie_is_left_out() -> None:
    scenes = [scene(number) for number in range(5)]
    found = judged_of(
        scenes,
        [
            verdict(scenes[0], Verdict.BOTH),
            verdict(scenes[0], Verdict.NEITHER, reviewer="bob"),
            verdict(scenes[0], Verdict.SUPERVISED, reviewer="cy"),
            verdict(scenes[1], Verdict.SUPERVISED),
            verdict(scenes[1], Verdict.NEITHER, reviewer="bob"),
            verdict(scenes[2], Verdict.UNSURE),
            verdict(scenes[3], Verdict.SUPERVISED, sha256="1" * 64),
            verdict(scenes[4], Verdict.SELF_SUPERVISED),
            verdict(scenes[4], Verdict.SUPERVISED, track_id=0),
        ],
    )
    assert found.number.tolist() == [0, 4]
    assert found.is_right.tolist() == [1.0, 1.0]


def test_verdicts_on_some_logs_teach_the_order_of_others() -> None:
    scenes, right = fleet()
    ranked, chances, effect = learned_ranking(scenes, judged(scenes, right, 40))
    assert effect.is_used
    assert (effect.verdicts, effect.right, effect.logs) == (40, sum(right[:40]), 12)
    figure = effect.average_precision
    assert None not in (figure.score, figure.learned, figure.low, effect.brier.high)
    assert (figure.learned or 0) > 0.9 > (figure.score or 1)
    assert (figure.low or 0) > 0 > (effect.brier.high or 0)
    assert sum(row.scenes for row in effect.reliability) == 40
    truth = dict(zip((each.scene_id for each in scenes), right, strict=True))
    unseen = {each.scene_id for each in scenes[40:]}
    before, after = (
        [truth[each.scene_id] for each in order if each.scene_id in unseen][:10]
        for order in (scenes, ranked)
    )
    assert (sum(before), sum(after)) == (3, 10)
    assert [each.rank for each in ranked] == list(range(1, 81))
    assert chances == sorted(chances, reverse=True)


def test_verdicts_without_a_gain_leave_the_score_in_charge() -> None:
    scenes, _ = fleet()
    right = [number < 20 for number in range(80)]
    ranked, chances, effect = learned_ranking(scenes, judged(scenes, right, 40))
    assert not effect.is_used
    assert ranked == scenes
    assert chances == pytest.approx([each.score for each in scenes])


def test_verdicts_that_all_agree_teach_nothing() -> None:
    scenes, _ = fleet()
    for outcome, of_score in ((True, 1.0), (False, None)):
        ranked, _, effect = learned_ranking(scenes, judged(scenes, [outcome] * 80, 40))
        assert not effect.is_used
        assert ranked == scenes
        assert effect.average_precision.score == of_score


def test_too_few_verdicts_and_a_single_log_are_refused() -> None:
    scenes, right = fleet()
    with pytest.raises(UsageError, match=f"^{MIN_VERDICTS - 1} scenes .* {MIN_VERDICTS} are"):
        learned_ranking(scenes, judged(scenes, right, MIN_VERDICTS - 1))
    learned_ranking(scenes, judged(scenes, right, MIN_VERDICTS))
    scenes, right = fleet(logs=1)
    with pytest.raises(UsageError, match="all 40 verdicts are on one log"):
        learned_ranking(scenes, judged(scenes, right, 40))


def test_a_log_is_never_on_both_sides_of_a_fold() -> None:
    logs = [f"log-{number % 13}" for number in range(60)]
    folds = list(folds_of(logs))
    assert np.sum(folds, axis=0).tolist() == [1] * 60
    for fold in folds:
        inside = {log for log, is_in in zip(logs, fold, strict=True) if is_in}
        assert inside.isdisjoint(log for log, is_in in zip(logs, fold, strict=True) if not is_in)


def test_average_precision_is_that_counted_by_hand() -> None:
    found = average_precision(np.array([1.0, 0.0, 1.0]), np.array([0.9, 0.5, 0.1]))
    assert found == pytest.approx((1 + 2 / 3) / 2)
    tied = average_precision(np.array([1.0, 0.0]), np.array([0.5, 0.5]))
    assert tied == pytest.approx(0.5)
    assert math.isnan(average_precision(np.zeros(2), np.array([0.5, 0.4])))


def test_equal_predictions_have_no_effect() -> None:
    is_right = (np.arange(30) % 3 == 0).astype(float)
    score = np.linspace(0.9, 0.1, 30)
    effect = effect_of(is_right, score, score, [f"log-{each}" for each in range(30)])
    assert not effect.is_used
    assert (effect.average_precision.low, effect.average_precision.high) == (0.0, 0.0)
