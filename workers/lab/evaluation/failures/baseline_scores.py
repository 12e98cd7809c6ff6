"""What a user would rank scenes by instead: one number a scene, higher is more suspicious."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from schemas.arrays import Mask
from schemas.contradiction import LabelledFrame, Scene
from schemas.labels import Agreement, MotionLabel

FLICKER_M: Final = 0.3
"""A label is compared with that of the nearest point of the frame before, if it lies so close."""

LEAST_SURE_SHARE: Final = 0.01


def views_of(scene: Scene) -> Mapping[str, float]:
    """Rank a scene as others would.

    Returns:
        `flicker`, labels of the supervised stream that change from one frame to the next, as a
        share of points off the ground; `point_share`, the share of compared points on which the
        streams differ (the paper's view), and the same off the ground; `free_space`, points that
        were seen through, which the supervised stream calls static, as a share; `confidence`, how
        unsure the supervised stream is of the least sure hundredth of the points off the ground,
        and `mean_confidence`, of all of them.
    """
    frames = scene.frames
    compared = differing = standing = standing_differing = 0
    for frame in frames:
        told = frame.agreements != Agreement.NOT_COMPARED
        differs = told & (frame.agreements != Agreement.BOTH_STATIC)
        differs &= frame.agreements != Agreement.BOTH_DYNAMIC
        off = _off_ground(frame)
        compared, differing = compared + int(told.sum()), differing + int(differs.sum())
        standing += int((told & off).sum())
        standing_differing += int((differs & off).sum())
    return {
        "flicker": flicker_share(frames),
        "point_share": _ratio(differing, compared),
        "point_share_off_ground": _ratio(standing_differing, standing),
        "free_space": free_space_share(frames),
        "confidence": unsureness(frames, share=LEAST_SURE_SHARE),
        "mean_confidence": unsureness(frames, share=1.0),
    }


def flicker_share(frames: Sequence[LabelledFrame]) -> float:
    """Share of points off the ground whose label is not that of the frame before, at their place.

    Both ways, so that it counts as well what was called dynamic and no longer is. Places are
    compared in odom space.
    """
    changed = asked = 0
    before: tuple[NDArray[np.float64], Mask] | None = None
    for frame in frames:
        told = _off_ground(frame) & (frame.semantic.labels != MotionLabel.UNKNOWN)
        places = _in_odom(frame)[told]
        dynamic = frame.semantic.labels[told] == MotionLabel.DYNAMIC
        if before is not None:
            asked += len(places)
            changed += _changes(places, dynamic, *before) + _changes(*before, places, dynamic)
        before = places, dynamic
    return _ratio(changed, asked)


def free_space_share(frames: Sequence[LabelledFrame]) -> float:
    """Share of judged points that were proved to move and the supervised stream says stand."""
    against = judged = 0
    for frame in frames:
        proved = proved_of(frame)
        told = frame.agreements != Agreement.NOT_COMPARED
        judged += int(told.sum())
        if proved is not None:
            static = frame.semantic.labels == MotionLabel.STATIC
            against += int((proved & static & _off_ground(frame)).sum())
    return _ratio(against, judged)


def unsureness(frames: Sequence[LabelledFrame], *, share: float) -> float:
    """How unsure the supervised stream is: mean over the least sure points of every frame."""
    means = []
    for frame in frames:
        told = _off_ground(frame) & (frame.semantic.labels != MotionLabel.UNKNOWN)
        unsure = 1.0 - frame.semantic.confidence[told].astype(np.float64)
        if len(unsure):
            count = max(1, round(share * len(unsure)))
            means.append(float(np.partition(unsure, -count)[-count:].mean()))
    return float(np.mean(means)) if means else 0.0


def proved_of(frame: LabelledFrame) -> Mask | None:
    """(N,) points that free space proved to move; None where nobody tells.

    The third witness where there is one; else what the self-supervised stream confirmed.
    """
    if frame.witness is not None:
        proved: Mask = frame.witness.labels == MotionLabel.DYNAMIC
        return proved
    return frame.predictive.confirmed


def _changes(
    places: NDArray[np.float64], dynamic: Mask, others: NDArray[np.float64], others_dynamic: Mask
) -> int:
    """Points called dynamic whose nearest point of the other frame is called static."""
    if not dynamic.any() or not len(others):
        return 0
    tree = cKDTree(others, balanced_tree=False, compact_nodes=False)
    _, nearest = tree.query(places[dynamic], distance_upper_bound=FLICKER_M)
    found = nearest[nearest < len(others)]
    return int((~others_dynamic[found]).sum())


def _in_odom(frame: LabelledFrame) -> NDArray[np.float64]:
    pose = frame.posed.odom_from_sensor
    return frame.posed.frame.points_m @ pose[:3, :3].T + pose[:3, 3]


def _off_ground(frame: LabelledFrame) -> Mask:
    valid, ground = frame.posed.frame.valid_mask, frame.predictive.ground_mask
    return valid if ground is None else valid & ~ground


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else 0.0
