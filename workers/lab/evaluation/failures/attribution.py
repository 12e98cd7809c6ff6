"""Accuracy of attribution: the recorded verdict of a contradicting track against ground truth."""

from collections import Counter
from collections.abc import Iterable
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from schemas.attribution import Wrong
from schemas.contradiction import ContradictionKind
from workers.lab.evaluation.failures.calibration import Calibration, calibrate
from workers.lab.evaluation.failures.rows import TrackRow

MIN_CASES: Final = 10
MIN_FRAMES: Final = 5
MIN_POINTS: Final = 25

_OF_SUPERVISED: Final = frozenset({ContradictionKind.ONLY_SEMANTIC_DYNAMIC.value})


class AttributionAccuracy(BaseModel):
    """Recorded against true verdicts, over contradicting tracks that are long and large enough."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    accuracy: float | None = Field(
        description="Mean recall over the verdicts that occur ten times; null: no verdicts."
    )
    commonest: float | None = Field(description="The same for a constant answer.")
    plain_accuracy: float | None = Field(description="Share of the tracks attributed correctly.")
    cases: dict[str, int] = Field(description="Tracks by true verdict.")
    recall: dict[str, float | None] = Field(description="By true verdict.")
    confusion: dict[str, dict[str, int]] = Field(description="True verdict, then recorded verdict.")
    calibration: Calibration = Field(description="Of the recorded verdict's probability.")


def is_evaluated(track: TrackRow) -> bool:
    """Test that a track is long and large enough, and that truth has a verdict on it."""
    enough = track.frames >= MIN_FRAMES and track.points >= MIN_POINTS * track.frames
    return enough and track.verdict is not None


def by_object(track: TrackRow) -> TrackRow:
    """Return a track with the verdict on objects, which a reviewer gives.

    Labels of the supervised stream that bled over the border of a mover, or flash on structure for
    less than half a second, lie on no object. By its points this stream is wrong there. But no
    object failed, so that a reviewer calls it a false alarm: the verdict is *neither*.
    """
    on_object = track.thing or track.true_track >= 0
    if on_object or track.kind not in _OF_SUPERVISED or track.verdict is not Wrong.SUPERVISED:
        return track
    return track.model_copy(update={"verdict": Wrong.NEITHER})


def evaluate_attribution(tracks: Iterable[TrackRow]) -> AttributionAccuracy:
    """Compare the recorded verdicts with the true ones."""
    judged = [track for track in tracks if is_evaluated(track)]
    cases = Counter(track.verdict for track in judged)
    confusion: dict[Wrong, Counter[Wrong]] = {verdict: Counter() for verdict in Wrong}
    sure: list[float] = []
    right: list[bool] = []
    for track in judged:
        if track.said is None or track.verdict is None:
            continue
        recorded = track.said.wrong
        confusion[track.verdict][recorded] += 1
        sure.append(getattr(track.said, recorded.value))
        right.append(recorded is track.verdict)
    total = sum(sum(row.values()) for row in confusion.values())
    recall = {
        verdict: confusion[verdict][verdict] / sum(confusion[verdict].values())
        if sum(confusion[verdict].values())
        else None
        for verdict in Wrong
    }
    common = [verdict for verdict in Wrong if cases[verdict] >= MIN_CASES]
    recalls = [value for verdict in common if (value := recall[verdict]) is not None]
    return AttributionAccuracy(
        accuracy=round(float(np.mean(recalls)), 4) if recalls else None,
        commonest=round(1.0 / len(common), 4) if common else None,
        plain_accuracy=round(sum(right) / total, 4) if total else None,
        cases={verdict.value: cases[verdict] for verdict in Wrong},
        recall={v.value: None if r is None else round(r, 4) for v, r in recall.items()},
        confusion={
            true.value: {recorded.value: row[recorded] for recorded in Wrong}
            for true, row in confusion.items()
        },
        calibration=calibrate(sure, np.array(right, dtype=np.bool_)),
    )
