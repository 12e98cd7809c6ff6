"""The glossary of failures, disturbances, remarks and evidence is whole and up to date."""

from pathlib import Path

import numpy as np

from schemas.contradiction import ContradictionKind
from service.cli.glossary_page import feature_meanings, glossary_page
from workers.contradiction.explanations import (
    EXPLANATION_TEXTS,
    MOST_PROBABLE,
    TYPICAL_OF_KIND,
    explanations_of,
)
from workers.contradiction.track_features import NAMES, TrackFeatures
from workers.lab.simulation.faults.plan import (
    DISTURBANCE_MEANS,
    FAILURE_MEANS,
    DisturbanceKind,
    FailureKind,
)

PAGE = Path(__file__).resolve().parents[2] / "deploy" / "GLOSSARY.md"


def test_the_glossary_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == glossary_page(), (
        "run `python -m service.cli.glossary_page > deploy/GLOSSARY.md`"
    )


def test_no_kind_and_no_number_of_evidence_is_missing() -> None:
    assert set(FAILURE_MEANS) == set(FailureKind)
    assert set(DISTURBANCE_MEANS) == set(DisturbanceKind)
    assert tuple(feature_meanings()) == NAMES
    page = glossary_page()
    assert all(f"| `{name}` |" in page for name in (*FailureKind, *DisturbanceKind, *NAMES))


def test_whatever_is_told_of_a_track_is_explained_and_nothing_else() -> None:
    rng = np.random.default_rng(3)
    told = {MOST_PROBABLE, *TYPICAL_OF_KIND.values()}
    for kind in ContradictionKind:
        for _ in range(1500):
            drawn = rng.choice([0.0, 0.1, 0.3, 0.6, 0.75, 1.0], len(NAMES))
            evidence = TrackFeatures(**dict(zip(NAMES, drawn.tolist(), strict=True)))
            size_m = rng.choice([0.1, 1.0, 30.0], 3)
            remarks = explanations_of(kind.value, evidence, size_m, of_witness=False)
            told |= {remark.words for remark in remarks}
    assert told == set(EXPLANATION_TEXTS)
