"""Blind moments: contradictions while the self-supervised stream labels nothing.

At the start of a log, after a gap and where the pose was lost, that stream has no past. The witness
then labels alone, and it too lacks the frames of one side: nothing tells a static object that is
seen from a slightly wrong pose from one that moves. Its evidence is worth the looks behind it.
"""

from collections.abc import Sequence

import numpy as np

from schemas.contradiction import Instance, Scene
from schemas.labels import MotionLabel


def blind_share(scene: Scene, members: Sequence[Instance]) -> float:
    """Return the share of a track's frames in which the self-supervised stream is blind, 0 to 1."""
    frames = [scene.frames[member.frame_index] for member in members]
    return float(np.mean([frame.predictive.health.blindness is not None for frame in frames]))


def witness_votes(scene: Scene, members: Sequence[Instance]) -> float:
    """Return the votes behind the witness's dynamic labels of a track, 0 to 1.

    Returns:
        Mean number of voting frames, as a share of those of a full second before and after; 0
        where the witness labels nothing dynamic. At either end of a log it is at most one half.
    """
    total, points = 0.0, 0
    for member in members:
        witness = scene.frames[member.frame_index].witness
        if witness is None:
            continue
        index = member.point_index
        moving = index[witness.labels[index] == MotionLabel.DYNAMIC]
        total += float(witness.confidence[moving].sum(dtype=np.float64))
        points += len(moving)
    return total / points if points else 0.0
