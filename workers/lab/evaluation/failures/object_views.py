"""Baseline scores that rank objects: uncertainty, flicker and disagreement of the networks."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.labels import MotionLabel
from workers.lab.evaluation.failures.baseline_scores import proven_moving
from workers.lab.evaluation.failures.frame_truth import FrameWithTruth


def object_baselines(
    points: Mapping[int, NDArray[np.int64]], seen: Sequence[FrameWithTruth]
) -> Mapping[str, float]:
    """Compute the baseline scores of an object as means over its points.

    Args:
        points: Its points, by frame of the scene.
        seen: Frames of the scene with their truth.

    Returns:
        `confidence`, one minus the supervised stream's confidence; `flicker`, the share of frame
        pairs in which the majority label changes; `point_share`, the share of its points on which
        the streams differ; `free_space`, the share that free space proves moving and the supervised
        stream labels static; of probed networks also `entropy`, `margin`, `mc_dropout` and
        `ensemble`, where they are finite.
    """
    unsure: list[NDArray[np.float64]] = []
    labels: list[bool] = []
    differing = against = total = 0
    for number, mine in sorted(points.items()):
        labelled = seen[number].labelled
        semantic, predictive = labelled.semantic, labelled.predictive
        valid = semantic.labels[mine] != MotionLabel.UNKNOWN
        total += len(mine)
        unsure.append(1.0 - semantic.confidence[mine][valid].astype(np.float64))
        if valid.any():
            labels.append(bool((semantic.labels[mine][valid] == MotionLabel.DYNAMIC).mean() > 0.5))
        both = valid & (predictive.labels[mine] != MotionLabel.UNKNOWN)
        differing += int((semantic.labels[mine] != predictive.labels[mine])[both].sum())
        proved = proven_moving(labelled)
        if proved is not None:
            against += int((proved[mine] & (semantic.labels[mine] == MotionLabel.STATIC)).sum())
    every = np.concatenate(unsure) if unsure else np.zeros(0)
    changes = np.diff(np.array(labels, dtype=np.int8))
    by_measure: dict[str, list[NDArray[np.float32]]] = {}
    for number, mine in points.items():
        for name, values in seen[number].unsure.items():
            by_measure.setdefault(name, []).append(values[mine])
    probed = {name: np.concatenate(values) for name, values in by_measure.items()}
    return {
        **{
            name: float(np.nanmean(values))
            for name, values in sorted(probed.items())
            if np.isfinite(values).any()
        },
        "confidence": float(every.mean()) if len(every) else 0.0,
        "flicker": float(np.count_nonzero(changes)) / max(1, len(changes)),
        "point_share": differing / total if total else 0.0,
        "free_space": against / total if total else 0.0,
    }
