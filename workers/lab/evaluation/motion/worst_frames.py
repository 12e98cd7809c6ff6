"""Worst frames: the frames in which a stream labels most points wrong."""

import heapq

import numpy as np

from schemas.labels import MotionLabel
from workers.lab.evaluation.motion.counts import RANGES_M
from workers.lab.evaluation.motion.motion import EvaluatedFrame
from workers.lab.evaluation.truth.truth import TRUTH_DYNAMIC, TRUTH_STATIC


def wrong_points(judged: EvaluatedFrame) -> int:
    """Count wrong points under 80 m: movers that were not found, static points labelled dynamic.

    Points of unknown truth are never wrong.
    """
    near = np.hypot(judged.points_m[:, 0], judged.points_m[:, 1]) < RANGES_M[-1]
    called = judged.labels == MotionLabel.DYNAMIC
    wrong = (judged.truth == TRUTH_DYNAMIC) & ~called | (judged.truth == TRUTH_STATIC) & called
    return int((near & wrong).sum())


class WorstFrames:
    """Keeps the frames with most wrong points, up to a given number."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._heap: list[tuple[int, int, EvaluatedFrame]] = []
        self._seen = 0

    def add(self, judged: EvaluatedFrame) -> None:
        """Add a frame; of two equally bad ones, the earlier is kept."""
        self._seen += 1
        entry = (wrong_points(judged), -self._seen, judged)
        if len(self._heap) < self._count:
            heapq.heappush(self._heap, entry)
        else:
            heapq.heappushpop(self._heap, entry)

    @property
    def frames(self) -> list[EvaluatedFrame]:
        """The kept frames, worst first."""
        return [judged for _, _, judged in sorted(self._heap, key=lambda e: e[:2], reverse=True)]
