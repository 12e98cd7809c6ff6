"""The glossary of failures, disturbances, remarks and evidence is whole and up to date."""

from pathlib import Path

import numpy as np

from schemas.contradiction import ContradictionKind
from service.cli.glossary_page import evidence_means, glossary_page
from workers.contradiction.explanations import AS_MOST, LIKELIEST, TOLD, remarks_on
from workers.contradiction.track_features import NAMES, Evidence
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
    assert tuple(evidence_means()) == NAMES
    page = glossary_page()
    assert all(f"| `{name}` |" in page for name in (*FailureKind, *DisturbanceKind, *NAMES))


def test_whatever_is_told_of_a_track_is_explained_and_nothing_else() -> None:
    rng = np.random.default_rng(3)
    told = {LIKELIEST, *AS_MOST.values()}
    for kind in ContradictionKind:
        for _ in range(1500):
            drawn = rng.choice([0.0, 0.1, 0.3, 0.6, 0.75, 1.0], len(NAMES))
            evidence = Evidence(**dict(zip(NAMES, drawn.tolist(), strict=True)))
            size_m = rng.choice([0.1, 1.0, 30.0], 3)
            remarks = remarks_on(kind.value, evidence, size_m, of_witness=False)
            told |= {remark.words for remark in remarks}
    assert told == set(TOLD)
