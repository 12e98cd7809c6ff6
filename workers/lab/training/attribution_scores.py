"""Leave-one-log-out evaluation of attribution tables, over tracks and over scenes."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from schemas.attribution import Wrong
from workers.contradiction.attribution import Table, chances, table_of
from workers.contradiction.score import combine
from workers.contradiction.score_settings import DEFAULT_SCORE
from workers.contradiction.track_features import NAMES
from workers.lab.evaluation.failures.attribution import MIN_CASES, by_object, is_evaluated
from workers.lab.evaluation.failures.calibration import calibrate
from workers.lab.evaluation.failures.retrieval import retrieve
from workers.lab.evaluation.failures.rows import MinedLog, SceneRow, TrackRow

MIN_FRAMES: Final = 3
"""Frames of a track for use in the fit."""

Prediction = tuple[TrackRow, Wrong, float]
"""A track, the verdict on it and the chance of that verdict."""

Fit = Callable[[Sequence[MinedLog]], Mapping[str, Mapping[str, Any]]]
"""Fits the rows of all kinds on mined logs."""


def usable_tracks(logs: Sequence[MinedLog]) -> list[TrackRow]:
    """List the tracks for the fit: long enough, with the true verdict on their object."""
    return [
        by_object(track)
        for log in logs
        for scene in log.scenes
        for track in scene.tracks
        if track.frames >= MIN_FRAMES and track.verdict is not None
    ]


def leave_one_log_out(logs: Sequence[MinedLog], fit: Fit) -> dict[str, Any]:
    """Evaluate a fit by leaving one log out in turn.

    Returns:
        By kind, and for all: tracks by true verdict, the recall of each verdict, their mean, the
        mean of those that occur ten times, and the calibration error of the verdicts' chances; for
        all also with the verdicts of `by_object`.
        `scenes` contains the retrieval figures of the rescored scenes.
    """
    predictions: list[Prediction] = []
    scores: list[float] = []
    wanted: list[bool] = []
    for log in logs:
        rows = fit([other for other in logs if other.log_id != log.log_id])
        tables = {kind: table_of(each) for kind, each in rows.items()}
        predictions += [
            (track, *_likeliest(tables[track.kind], track))
            for scene in log.scenes
            for track in scene.tracks
            if track.kind in tables and is_evaluated(track)
        ]
        scores += [rescored(scene, tables) for scene in log.scenes]
        wanted += [scene.fails for scene in log.scenes]
    found = retrieve(np.array(scores), np.array(wanted, dtype=np.bool_))
    kinds = sorted({track.kind for track, _, _ in predictions})
    return {
        **{kind: _recalls(each for each in predictions if each[0].kind == kind) for kind in kinds},
        "all": _recalls(predictions),
        "all_with_borders_as_neither": _recalls(
            (by_object(track), answer, chance) for track, answer, chance in predictions
        ),
        "scenes": {
            "scenes": len(scores),
            "failing": sum(wanted),
            "ap": None if found.ap is None else round(found.ap, 4),
            "precision_at": {name: round(each, 4) for name, each in found.precision_at.items()},
        },
    }


def rescored(scene: SceneRow, tables: Mapping[str, Table]) -> float:
    """Compute the score of a scene with other attribution tables."""
    strengths = []
    for track in scene.tracks:
        chance = chances(tables[track.kind], _complete(track))
        worth = chance[Wrong.SUPERVISED] + chance[Wrong.BOTH]
        strengths.append(track.gate * track.presence * worth)
    return combine(strengths, decay=DEFAULT_SCORE.decay)


def _recalls(predictions: Iterable[Prediction]) -> dict[str, Any]:
    by_answer: dict[Wrong, list[bool]] = {}
    sure: list[float] = []
    right: list[bool] = []
    for track, predicted, chance in predictions:
        if track.verdict is not None:
            by_answer.setdefault(track.verdict, []).append(predicted is track.verdict)
            sure.append(chance)
            right.append(predicted is track.verdict)
    recall = {a.value: round(float(np.mean(by_answer[a])), 3) for a in sorted(by_answer)}
    common = [recall[a.value] for a in by_answer if len(by_answer[a]) >= MIN_CASES]
    return {
        "tracks": {answer.value: len(by_answer[answer]) for answer in sorted(by_answer)},
        "recall": recall,
        "balanced_accuracy": round(float(np.mean(list(recall.values()))), 3) if recall else None,
        "balanced_accuracy_of_common": round(float(np.mean(common)), 3) if common else None,
        "calibration_error": calibrate(sure, np.array(right, dtype=np.bool_)).ece,
    }


def _likeliest(table: Table, track: TrackRow) -> tuple[Wrong, float]:
    known = chances(table, _complete(track))
    answer = max(Wrong, key=lambda wrong: known[wrong])
    return answer, known[answer]


def _complete(track: TrackRow) -> Mapping[str, float]:
    """Return the evidence of a track; features that it was mined without are 0."""
    return dict.fromkeys(NAMES, 0.0) | track.evidence
