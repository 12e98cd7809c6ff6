"""Baseline scores that rank scenes: one number per scene, higher is more suspicious."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from schemas.arrays import Mask
from schemas.contradiction import LabelledFrame, Scene
from schemas.labels import Agreement, MotionLabel
from workers.lab.evaluation.failures.nearest_points import NearestPoints

LEAST_SURE_SHARE: Final = 0.01


def scene_baselines(scene: Scene, nearest: NearestPoints | None = None) -> Mapping[str, float]:
    """Compute the baseline scores of a scene.

    Args:
        scene: The scene.
        nearest: Nearest points of its frames, where many variants of a drive share them.

    Returns:
        `flicker`, the share of points off the ground whose supervised label changes from one frame
        to the next; `point_share`, the share of compared points on which the streams differ (the
        paper's measure); `point_share_off_ground`, the same off the ground; `free_space`, the share
        of points seen through that the supervised stream labels static; `confidence`, one minus the
        confidence of the supervised stream over the least confident hundredth of the points off the
        ground; `mean_confidence`, the same over all of them.
    """
    frames = scene.frames
    compared = differing = standing = standing_differing = 0
    for frame in frames:
        valid = frame.agreements != Agreement.NOT_COMPARED
        differs = valid & (frame.agreements != Agreement.BOTH_STATIC)
        differs &= frame.agreements != Agreement.BOTH_DYNAMIC
        off = _off_ground(frame)
        compared, differing = compared + int(valid.sum()), differing + int(differs.sum())
        standing += int((valid & off).sum())
        standing_differing += int((differs & off).sum())
    return {
        "flicker": flicker_share(frames, nearest),
        "point_share": _ratio(differing, compared),
        "point_share_off_ground": _ratio(standing_differing, standing),
        "free_space": free_space_share(frames),
        "confidence": mean_uncertainty(frames, share=LEAST_SURE_SHARE),
        "mean_confidence": mean_uncertainty(frames, share=1.0),
    }


def flicker_share(frames: Sequence[LabelledFrame], nearest: NearestPoints | None = None) -> float:
    """Return the share of points off the ground whose label differs from the frame before.

    Both directions count, so a point that is no longer dynamic counts too. Positions are compared
    in odom space.
    """
    finder = NearestPoints() if nearest is None else nearest
    changed = asked = 0
    before: LabelledFrame | None = None
    for frame in frames:
        asked += int(_labelled_off_ground(frame).sum())
        if before is not None:
            changed += _changes(finder, frame, before) + _changes(finder, before, frame)
        before = frame
    return _ratio(changed, asked)


def free_space_share(frames: Sequence[LabelledFrame]) -> float:
    """Return the share of compared points that free space proves moving and labels call static."""
    against = judged = 0
    for frame in frames:
        proved = proven_moving(frame)
        valid = frame.agreements != Agreement.NOT_COMPARED
        judged += int(valid.sum())
        if proved is not None:
            static = frame.semantic.labels == MotionLabel.STATIC
            against += int((proved & static & _off_ground(frame)).sum())
    return _ratio(against, judged)


def mean_uncertainty(frames: Sequence[LabelledFrame], *, share: float) -> float:
    """Return one minus the confidence, averaged over the least confident points of each frame."""
    means = []
    for frame in frames:
        valid = _off_ground(frame) & (frame.semantic.labels != MotionLabel.UNKNOWN)
        unsure = 1.0 - frame.semantic.confidence[valid].astype(np.float64)
        if len(unsure):
            count = max(1, round(share * len(unsure)))
            means.append(float(np.partition(unsure, -count)[-count:].mean()))
    return float(np.mean(means)) if means else 0.0


def proven_moving(frame: LabelledFrame) -> Mask | None:
    """Return (N,) points that free space proved to move; None where no part reports it.

    They come from the third witness where there is one, else from the confirmed points of the
    self-supervised stream.
    """
    if frame.witness is not None:
        proved: Mask = frame.witness.labels == MotionLabel.DYNAMIC
        return proved
    return frame.predictive.confirmed


def _changes(nearest: NearestPoints, frame: LabelledFrame, other: LabelledFrame) -> int:
    """Count the dynamic points whose nearest point of the other frame is static."""
    valid, others = _labelled_off_ground(frame), _labelled_off_ground(other)
    dynamic = valid & (frame.semantic.labels == MotionLabel.DYNAMIC)
    found = nearest.of(frame, valid, other, others, dynamic)
    return int((other.semantic.labels[found] != MotionLabel.DYNAMIC).sum())


def _labelled_off_ground(frame: LabelledFrame) -> Mask:
    known: Mask = _off_ground(frame) & (frame.semantic.labels != MotionLabel.UNKNOWN)
    return known


def _off_ground(frame: LabelledFrame) -> Mask:
    valid, ground = frame.posed.frame.valid_mask, frame.predictive.ground_mask
    return valid if ground is None else valid & ~ground


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else 0.0
