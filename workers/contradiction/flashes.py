"""Flashes: labels of the supervised stream alone that end within half a second.

A failure that is worth a review lasts half a second; networks also flash on structure for two to
four frames. Where the supervised stream alone labels an object dynamic, the other stream labels it
static, which it does in nearly every frame. The time of the error is therefore known. That of a
missed mover is not: its motion is proved in some of its frames only, so that two of them can be all
that is seen of a long failure.
"""

from typing import Final

from schemas.task import Outcome, Task
from workers.contradiction.clamp import clamp01

_FLASH_S: Final = 0.25
"""Time up to which a label is a flash, seconds."""

_FAILURE_S: Final = 0.5
"""Time from which on it can be a failure, seconds."""


def has_no_motion_source(kind: Outcome, task: Task) -> bool:
    """Return whether the supervised stream alone labels a track of this kind dynamic."""
    return not (kind.of_witness or kind.measured) and kind.semantic == task.moving


def label_time(kind: Outcome, task: Task, *, frames: int, period_s: float) -> float:
    """Return how far the label of a track is from a flash, 0 to 1.

    Args:
        kind: Kind of the track.
        task: Its task.
        frames: Frames in which the supervised stream alone labels it dynamic.
        period_s: Median time between frames; 0 for a single frame.

    Returns:
        0 up to a quarter of a second, 1 from half a second on; 1 for other kinds and for a single
        frame.
    """
    if period_s <= 0.0 or not has_no_motion_source(kind, task):
        return 1.0
    return clamp01((frames * period_s - _FLASH_S) / (_FAILURE_S - _FLASH_S))
