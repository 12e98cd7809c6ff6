"""What is told for and against a verdict, by its weight in the table."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from schemas.attribution import MOST_WORDS, Attribution, Wrong
from schemas.contradiction import ContradictionKind
from workers.contradiction import attribution
from workers.contradiction.attribution import (
    NOTHING,
    attribute,
    chances,
    table_of,
    tables,
    weight_of,
)
from workers.contradiction.explanations import AS_MOST, LIKELIEST, Remark, remarks_on
from workers.contradiction.track_features import NAMES, Evidence

KIND = ContradictionKind.ONLY_SEMANTIC_DYNAMIC.value


def _evidence(**known: float) -> Evidence:
    return Evidence(**{**dict.fromkeys(NAMES, 0.0), "steady": 1.0, "many_points": 1.0, **known})


def _said(kind: ContradictionKind, **known: float) -> Attribution:
    evidence, size_m = _evidence(**known), np.array([4.0, 1.8, 1.5])
    of_witness = kind is ContradictionKind.ONLY_WITNESS_DYNAMIC
    remarks = remarks_on(kind.value, evidence, size_m, of_witness=of_witness)
    return attribute(kind.value, evidence, remarks=remarks)


def test_what_is_known_is_told_as_for_against_or_neither() -> None:
    said = _said(
        ContradictionKind.ONLY_PREDICTIVE_DYNAMIC,
        **dict.fromkeys(("witness_moving", "confirmed", "straight", "speed_fits", "went"), 1.0),
        undenied_after=1.0,
        crowded=0.8,
        many_points=0.3,
    )
    assert said.wrong is Wrong.SUPERVISED
    assert said.because == ("nobody denies later that it moves", "the witness sees it move")
    assert said.against == ("much else contradicts alike",)
    assert said.also == ("few points",)


def test_the_same_evidence_speaks_for_one_answer_and_against_another() -> None:
    parked = {"witness_still": 0.7, "denied": 1.0, "supervised_sure": 0.9, "own": 0.9}
    errs = _said(ContradictionKind.ONLY_SEMANTIC_DYNAMIC, **parked)
    starts = _said(ContradictionKind.ONLY_SEMANTIC_DYNAMIC, **parked, undenied_after=1.0, went=1.0)
    assert (errs.wrong, starts.wrong) == (Wrong.SUPERVISED, Wrong.SELFSUPERVISED)
    assert "the witness sees it stand" in errs.because
    assert "the witness sees it stand" in starts.against


@pytest.mark.parametrize("kind", list(ContradictionKind))
@pytest.mark.parametrize("wrong", list(Wrong))
def test_a_weight_is_what_evidence_does_to_the_odds_that_the_supervised_stream_is_wrong(
    kind: ContradictionKind, wrong: Wrong
) -> None:
    table, known = tables()[kind.value], _evidence(far=0.9, turning=0.5, low=0.7).named()
    sign = 1.0 if wrong in (Wrong.SUPERVISED, Wrong.BOTH) else -1.0

    def odds(evidence: Mapping[str, float]) -> float:
        told = chances(table, evidence)
        errs = told[Wrong.SUPERVISED] + told[Wrong.BOTH]
        return errs / (1.0 - errs)

    for name in ("far", "turning", "low"):
        there, without = odds(known), odds({**known, name: 0.0})
        weight = weight_of({name: 0.0}, table, known, wrong)
        assert weight == pytest.approx(sign * np.log(there / without))


def test_motion_that_the_witness_sees_too_never_speaks_for_the_one_who_says_it_stands() -> None:
    """Whoever of the other three answers it is: what two see move, the third is wrong about."""
    blurred = {"low": 1.0, "witness_moving": 0.8, "supervised_sure": 0.9, "confirmed": 0.5}
    said = _said(ContradictionKind.ONLY_PREDICTIVE_DYNAMIC, **blurred)
    assert said.wrong is Wrong.SELFSUPERVISED
    assert "the witness sees it move" in said.against


def test_what_the_table_does_not_ask_for_speaks_neither_for_nor_against() -> None:
    said = attribute(KIND, _evidence(), remarks=(Remark("it rains", {}),))
    assert (said.against, said.also) == ((), ("it rains",))
    assert NOTHING > 0.0


def test_what_the_witness_alone_sees_move_is_not_said_to_be_seen_by_it() -> None:
    said = _said(ContradictionKind.ONLY_WITNESS_DYNAMIC, witness_moving=1.0, far=0.9)
    assert "the witness sees it move" not in {*said.because, *said.against, *said.also}
    assert "far" in {*said.because, *said.against, *said.also}


def _by(
    patched: pytest.MonkeyPatch, intercept: float, evidence: Evidence, **weights: float
) -> Attribution:
    """Attribute by a table that begins even between two answers, but for an intercept."""
    rows = {
        "supervised": {"intercept": intercept, "weights": weights},
        "selfsupervised": {"intercept": 0.0, "weights": {}},
    }
    patched.setattr(attribution, "tables", lambda: {KIND: table_of(rows)})
    remarks = remarks_on(KIND, evidence, np.array([4.0, 1.8, 1.5]), of_witness=False)
    return attribute(KIND, evidence, remarks=remarks)


def test_where_all_that_is_told_speaks_against_it_the_weightiest_of_the_rest_speaks_for_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    weights = {"far": -0.5, "low": -0.7, "witness_still": 1.0, "went": -3.0, "own": 2.0}
    evidence = _evidence(far=0.9, low=1.0, own=1.0, went=0.1)
    said = _by(monkeypatch, 1.0, evidence, **weights)
    assert said.wrong is Wrong.SUPERVISED
    assert (said.because, said.against) == (("its boxes go nowhere",), ("low", "far"))
    seen = _by(monkeypatch, 1.0, replace(evidence, witness_still=1.0), **weights)
    assert seen.because == ("the witness sees it stand",), "enough is told"


@pytest.mark.parametrize(
    ("went", "straight", "words"),
    [(0.9, 0.9, "it goes its way"), (0.1, 0.0, "its boxes go nowhere"), (0.4, 0.9, AS_MOST[KIND])],
)
def test_how_a_thing_goes_is_told_by_both_numbers_of_its_path(
    went: float, straight: float, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    weight = 1.0 if went > 0.5 else -1.0
    evidence = _evidence(went=went, straight=straight, own=0.5)
    said = _by(monkeypatch, 3.0, evidence, went=weight, straight=weight)
    assert said.because == (words,)


def test_where_no_evidence_speaks_for_it_the_kind_does(monkeypatch: pytest.MonkeyPatch) -> None:
    evidence = _evidence(far=1.0, own=0.5, road_user=0.5, went=0.3)
    said = _by(monkeypatch, 2.0, evidence, far=-1.0)
    assert (said.because, said.against) == ((AS_MOST[KIND],), ("far",))


def test_an_answer_that_the_kind_speaks_against_too_is_the_likeliest_of_four(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows = {name: {"intercept": 0.4, "weights": {}} for name in ("selfsupervised", "neither")}
    rows["supervised"] = {"intercept": 0.5, "weights": {}}
    monkeypatch.setattr(attribution, "tables", lambda: {KIND: table_of(rows)})
    said = attribute(KIND, _evidence(far=1.0), remarks=(Remark("far", {"far": 0.0}),))
    assert said.wrong is Wrong.SUPERVISED
    assert said.supervised < 0.5
    assert (said.because, said.also) == ((LIKELIEST,), ("far",))


@pytest.mark.parametrize("kind", list(ContradictionKind))
def test_no_verdict_is_without_a_word_for_it(kind: ContradictionKind) -> None:
    rng = np.random.default_rng(7)
    for _ in range(300):
        said = _said(kind, **dict(zip(NAMES, rng.random(len(NAMES)).round(2), strict=True)))
        assert said.because
        assert len(said.because) + len(said.against) + len(said.also) <= MOST_WORDS


def test_of_too_much_that_is_known_the_weightiest_is_told() -> None:
    loud = dict.fromkeys(("agreed_before", "undenied_after", "witness_still", "far"), 1.0)
    loud |= dict.fromkeys(("doubted", "crowded", "turning", "low", "thin"), 1.0)
    said = _said(ContradictionKind.ONLY_PREDICTIVE_DYNAMIC, **loud, many_points=0.1, steady=0.1)
    assert len(said.because) + len(said.against) + len(said.also) == MOST_WORDS
    assert said.because[0] == "the witness sees it stand"
    assert "few points" not in said.also


def test_where_the_ground_itself_rises_nothing_speaks_against_the_supervised_stream() -> None:
    sure = ("witness_moving", "went", "straight", "own", "confirmed", "steady", "many_points")
    shaken = dict.fromkeys(("ground_rises", *sure), 1.0)
    for kind in ("only_predictive_dynamic", "only_witness_dynamic"):
        evidence = dict.fromkeys(NAMES, 0.0) | shaken
        rises = chances(tables()[kind], evidence)
        still = chances(tables()[kind], evidence | {"ground_rises": 0.0})
        wrong = (Wrong.SUPERVISED, Wrong.BOTH)
        assert sum(rises[each] for each in wrong) < 0.1 < 0.3 < sum(still[each] for each in wrong)
    said = remarks_on(KIND, _evidence(ground_rises=0.9), np.ones(3), of_witness=False)
    assert "the ground rises around it" in [remark.words for remark in said]
