"""Explanations for and against an attribution, by their weight in the table."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from schemas.attribution import MAX_EVIDENCE, Attribution, Wrong
from schemas.contradiction import ContradictionKind
from workers.contradiction import attribution
from workers.contradiction.attribution import (
    NEGLIGIBLE,
    attribute,
    chances,
    table_of,
    tables,
    weight_of,
)
from workers.contradiction.explanations import (
    MOST_PROBABLE,
    TYPICAL_OF_KIND,
    Explanation,
    explanations_of,
)
from workers.contradiction.track_features import NAMES, TrackFeatures

KIND = ContradictionKind.ONLY_SEMANTIC_DYNAMIC.value


def _evidence(**known: float) -> TrackFeatures:
    return TrackFeatures(
        **{
            **dict.fromkeys(NAMES, 0.0),
            "continuity": 1.0,
            "point_count": 1.0,
            "label_time": 1.0,
            **known,
        }
    )


def _said(kind: ContradictionKind, **known: float) -> Attribution:
    evidence, size_m = _evidence(**known), np.array([4.0, 1.8, 1.5])
    of_witness = kind is ContradictionKind.ONLY_WITNESS_DYNAMIC
    explanations = explanations_of(kind.value, evidence, size_m, of_witness=of_witness)
    return attribute(kind.value, evidence, explanations=explanations)


def test_explanations_are_supporting_opposing_or_neutral() -> None:
    said = _said(
        ContradictionKind.ONLY_PREDICTIVE_DYNAMIC,
        **dict.fromkeys(
            ("witness_dynamic", "confirmed", "straightness", "speed_consistency", "displacement"),
            1.0,
        ),
        not_refuted_after=1.0,
        clutter=0.8,
        point_count=0.3,
    )
    assert said.wrong is Wrong.SUPERVISED
    assert said.supporting == ("witness label dynamic", "not refuted later")
    assert said.opposing == ("clutter of like contradictions",)
    assert said.neutral == ("few points",)


def test_the_same_evidence_supports_one_attribution_and_opposes_another() -> None:
    parked = {
        "witness_static": 0.7,
        "denied_share": 1.0,
        "supervised_confidence": 0.9,
        "isolation": 0.9,
    }
    errs = _said(ContradictionKind.ONLY_SEMANTIC_DYNAMIC, **parked, shape_static=1.0)
    starts = _said(
        ContradictionKind.ONLY_SEMANTIC_DYNAMIC, **parked, not_refuted_after=1.0, displacement=1.0
    )
    assert (errs.wrong, starts.wrong) == (Wrong.SUPERVISED, Wrong.SELFSUPERVISED)
    assert "witness label static" in errs.supporting
    assert "witness label static" in starts.opposing


@pytest.mark.parametrize("kind", list(ContradictionKind))
@pytest.mark.parametrize("wrong", list(Wrong))
def test_a_weight_is_what_evidence_does_to_the_odds_that_the_supervised_stream_is_wrong(
    kind: ContradictionKind, wrong: Wrong
) -> None:
    table, known = tables()[kind.value], _evidence(distance=0.9, turn_rate=0.5, lowness=0.7).named()
    sign = 1.0 if wrong in (Wrong.SUPERVISED, Wrong.BOTH) else -1.0

    def odds(evidence: Mapping[str, float]) -> float:
        told = chances(table, evidence)
        errs = told[Wrong.SUPERVISED] + told[Wrong.BOTH]
        return errs / (1.0 - errs)

    for name in ("distance", "turn_rate", "lowness"):
        there, without = odds(known), odds({**known, name: 0.0})
        weight = weight_of({name: 0.0}, table, known, wrong)
        assert weight == pytest.approx(sign * np.log(there / without))


def test_motion_that_the_witness_sees_too_never_speaks_for_the_one_who_says_it_stands() -> None:
    """Whoever of the other three answers it is: what two see move, the third is wrong about."""
    blurred = {
        "lowness": 1.0,
        "witness_dynamic": 0.8,
        "supervised_confidence": 0.9,
        "confirmed": 0.5,
    }
    said = _said(ContradictionKind.ONLY_PREDICTIVE_DYNAMIC, **blurred)
    assert said.wrong is Wrong.SELFSUPERVISED
    assert "witness label dynamic" in said.opposing


def test_a_feature_without_a_weight_is_neutral() -> None:
    said = attribute(KIND, _evidence(), explanations=(Explanation("it rains", {}),))
    assert (said.opposing, said.neutral) == ((), ("it rains",))
    assert NEGLIGIBLE > 0.0


def test_what_the_witness_alone_sees_move_is_not_said_to_be_seen_by_it() -> None:
    said = _said(ContradictionKind.ONLY_WITNESS_DYNAMIC, witness_dynamic=1.0, distance=0.9)
    assert "witness label dynamic" not in {*said.supporting, *said.opposing, *said.neutral}
    assert "long range" in {*said.supporting, *said.opposing, *said.neutral}


def _by(
    patched: pytest.MonkeyPatch, intercept: float, evidence: TrackFeatures, **weights: float
) -> Attribution:
    """Attribute by a table that begins even between two answers, but for an intercept."""
    rows = {
        "supervised": {"intercept": intercept, "weights": weights},
        "selfsupervised": {"intercept": 0.0, "weights": {}},
    }
    patched.setattr(attribution, "tables", lambda: {KIND: table_of(rows)})
    explanations = explanations_of(KIND, evidence, np.array([4.0, 1.8, 1.5]), of_witness=False)
    return attribute(KIND, evidence, explanations=explanations)


def test_where_all_that_is_told_speaks_against_it_the_weightiest_of_the_rest_speaks_for_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    weights = {
        "distance": -0.5,
        "lowness": -0.7,
        "witness_static": 1.0,
        "displacement": -3.0,
        "isolation": 2.0,
    }
    evidence = _evidence(distance=0.9, lowness=1.0, isolation=1.0, displacement=0.1)
    said = _by(monkeypatch, 1.0, evidence, **weights)
    assert said.wrong is Wrong.SUPERVISED
    assert (said.supporting, said.opposing) == (("no displacement",), ("low height", "long range"))
    seen = _by(monkeypatch, 1.0, replace(evidence, witness_static=1.0), **weights)
    assert seen.supporting == ("witness label static",), "enough is told"


@pytest.mark.parametrize(
    ("went", "straight", "words"),
    [
        (0.9, 0.9, "straight displacement"),
        (0.1, 0.0, "no displacement"),
        (0.4, 0.9, TYPICAL_OF_KIND[KIND]),
    ],
)
def test_how_a_thing_goes_is_told_by_both_numbers_of_its_path(
    went: float, straight: float, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    weight = 1.0 if went > 0.5 else -1.0
    evidence = _evidence(displacement=went, straightness=straight, isolation=0.5)
    said = _by(monkeypatch, 3.0, evidence, displacement=weight, straightness=weight)
    assert said.supporting == (words,)


def test_without_supporting_evidence_the_kind_supports_the_attribution(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    evidence = _evidence(distance=1.0, isolation=0.5, road_user_size=0.5, displacement=0.3)
    said = _by(monkeypatch, 2.0, evidence, distance=-1.0)
    assert (said.supporting, said.opposing) == ((TYPICAL_OF_KIND[KIND],), ("long range",))


def test_an_answer_that_the_kind_speaks_against_too_is_the_likeliest_of_four(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rows = {name: {"intercept": 0.4, "weights": {}} for name in ("selfsupervised", "neither")}
    rows["supervised"] = {"intercept": 0.5, "weights": {}}
    monkeypatch.setattr(attribution, "tables", lambda: {KIND: table_of(rows)})
    said = attribute(
        KIND, _evidence(distance=1.0), explanations=(Explanation("long range", {"distance": 0.0}),)
    )
    assert said.wrong is Wrong.SUPERVISED
    assert said.supervised < 0.5
    assert (said.supporting, said.neutral) == ((MOST_PROBABLE,), ("long range",))


@pytest.mark.parametrize("kind", list(ContradictionKind))
def test_every_attribution_has_supporting_evidence(kind: ContradictionKind) -> None:
    rng = np.random.default_rng(7)
    for _ in range(300):
        said = _said(kind, **dict(zip(NAMES, rng.random(len(NAMES)).round(2), strict=True)))
        assert said.supporting
        assert len(said.supporting) + len(said.opposing) + len(said.neutral) <= MAX_EVIDENCE


def test_the_weightiest_explanations_are_kept() -> None:
    loud = dict.fromkeys(("agreed_before", "not_refuted_after", "witness_static", "distance"), 1.0)
    loud |= dict.fromkeys(("pose_doubted", "clutter", "turn_rate", "lowness", "thinness"), 1.0)
    said = _said(ContradictionKind.ONLY_PREDICTIVE_DYNAMIC, **loud, point_count=0.1, continuity=0.1)
    assert len(said.supporting) + len(said.opposing) + len(said.neutral) == MAX_EVIDENCE
    assert said.supporting[0] == "witness label static"
    assert "few points" not in said.neutral


def test_where_the_ground_itself_rises_nothing_speaks_against_the_supervised_stream() -> None:
    sure = (
        "witness_dynamic",
        "displacement",
        "straightness",
        "isolation",
        "confirmed",
        "continuity",
        "point_count",
    )
    shaken = dict.fromkeys(("rising_ground", *sure), 1.0)
    for kind in ("only_predictive_dynamic", "only_witness_dynamic"):
        evidence = dict.fromkeys(NAMES, 0.0) | shaken
        rises = chances(tables()[kind], evidence)
        still = chances(tables()[kind], evidence | {"rising_ground": 0.0})
        wrong = (Wrong.SUPERVISED, Wrong.BOTH)
        assert sum(rises[each] for each in wrong) < 0.1 < 0.3 < sum(still[each] for each in wrong)
    said = explanations_of(KIND, _evidence(rising_ground=0.9), np.ones(3), of_witness=False)
    assert "rising ground around it" in [remark.words for remark in said]
