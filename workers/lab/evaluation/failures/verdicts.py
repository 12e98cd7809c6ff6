"""True verdicts on contradicting tracks: one stream is wrong, the other, both or neither."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.attribution import Wrong
from schemas.contradiction import Instance
from schemas.labels import MotionLabel
from workers.lab.evaluation.failures.frame_truth import FrameWithTruth
from workers.lab.evaluation.failures.objects_of_interest import ObjectOfInterest
from workers.lab.evaluation.truth.truth import TRUTH_DYNAMIC, TRUTH_STATIC, TRUTH_UNKNOWN

Points = NDArray[np.int64]

MOST: Final = 0.5
"""Share of an object's points on which a stream must be wrong."""


def object_under(
    members: Sequence[Instance], seen: Sequence[FrameWithTruth], things: Sequence[ObjectOfInterest]
) -> tuple[str, int]:
    """Find the object below a contradicting track.

    Returns:
        Its key, empty for none, and the true object that half of the points belong to, -1 none.
    """
    on_track: dict[int, int] = {}
    on_thing: dict[str, int] = {}
    total = 0
    unowned = [thing for thing in things if thing.track < 0]
    for member in members:
        total += len(member.point_index)
        ids, counts = np.unique(
            seen[member.frame_index].track[member.point_index], return_counts=True
        )
        for track, count in zip(ids.tolist(), counts.tolist(), strict=True):
            on_track[track] = on_track.get(track, 0) + count
        for thing in unowned:
            theirs = thing.points.get(member.frame_index)
            if theirs is not None:
                both = len(np.intersect1d(theirs, member.point_index))
                on_thing[thing.key] = on_thing.get(thing.key, 0) + both
    track = max(on_track, key=lambda each: (on_track[each], -each), default=-1)
    if track >= 0 and 2 * on_track[track] >= total:
        key = f"track {track}"
        return (key if any(thing.key == key for thing in things) else ""), track
    key = max(on_thing, key=lambda each: (on_thing[each], each), default="")
    return (key if key and 2 * on_thing[key] >= total else ""), -1


def verdict_of(
    members: Sequence[Instance], seen: Sequence[FrameWithTruth], *, track: int
) -> Wrong | None:
    """Compute the verdict on a track from the object below it, over the frames of the track.

    A stream is wrong if it labels most of the object opposite to the truth. Where the points belong
    to no object, the contradicting points themselves are the object.

    Args:
        members: Its instances.
        seen: The frames of the scene.
        track: True object it lies on, -1 none.

    Returns:
        The verdict; None where truth knows less than half of the points.
    """
    labels: list[NDArray[np.uint8]] = [np.zeros((3, 0), np.uint8)]
    for member in members:
        frame = seen[member.frame_index]
        mine: Points = np.flatnonzero(frame.track == track) if track >= 0 else member.point_index
        streams = frame.labelled.semantic.labels[mine], frame.labelled.predictive.labels[mine]
        labels.append(np.stack([*streams, frame.motion[mine]]))
    semantic, predictive, true = np.concatenate(labels, axis=1)
    known = true != TRUTH_UNKNOWN
    if not known.any() or 2 * known.sum() < len(known):
        return None
    return wrong_about(semantic[known], predictive[known], true[known])


def wrong_about(
    semantic: NDArray[np.uint8], predictive: NDArray[np.uint8], true: NDArray[np.uint8]
) -> Wrong:
    """Return the stream that is wrong on most of the points; an UNKNOWN label is not wrong.

    Args:
        semantic: (N,) labels of the supervised stream, N >= 1.
        predictive: (N,) labels of the self-supervised stream.
        true: (N,) true motion, in codes of the truth, all known.
    """
    supervised = _wrong_share(semantic, true) > MOST
    selfsupervised = _wrong_share(predictive, true) > MOST
    if supervised and selfsupervised:
        return Wrong.BOTH
    if supervised:
        return Wrong.SUPERVISED
    return Wrong.SELFSUPERVISED if selfsupervised else Wrong.NEITHER


def _wrong_share(labels: NDArray[np.uint8], true: NDArray[np.uint8]) -> float:
    missed = (labels == MotionLabel.STATIC) & (true == TRUTH_DYNAMIC)
    phantom = (labels == MotionLabel.DYNAMIC) & (true == TRUTH_STATIC)
    return float((missed | phantom).mean())
