"""Lidar by lidar: a network labels the cloud of each lidar of a joined frame for itself.

Rows of a range image are the beams of one sensor, and networks are trained on such clouds. Recorded
answers are joined with the points already, and boxes label the points of all lidars.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from schemas.frame import PosedFrame
from schemas.labels import FrameLabels
from workers.lidar.several_lidars import lidar_frame
from workers.parts.protocols import Stream

RECORDED: Final = "recorded"
"""Name of the supervised stream whose answers ingest joins with the points."""


def labels_of_lidars(stream: Stream, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
    """Yield the labels of each frame; a network runs once for each lidar of it."""
    if stream.version.partition("@")[0] == RECORDED:
        yield from stream(frames)
        return
    source = _Split(frames)
    first = source.peek()
    if first is None or not first.frame.joined:
        yield from stream(source.whole())
        return
    answers = [stream(source.of(lidar)) for lidar in range(len(first.frame.joined) + 1)]
    for posed in source.whole():
        said = [next(answers[0])]
        for number, lidar in enumerate(posed.frame.joined):
            if lidar.points:
                said.append(next(answers[number + 1]))
        yield _joined(said)


class _Split:
    """Joined frames, drawn once, for those who read the frames of one lidar each."""

    def __init__(self, frames: Iterable[PosedFrame]) -> None:
        self._frames = iter(frames)
        self._waiting: list[deque[PosedFrame]] = []
        self._whole: deque[PosedFrame] = deque()

    def peek(self) -> PosedFrame | None:
        """Return the first frame; None without any."""
        self._draw()
        first = self._whole[0] if self._whole else None
        count = 1 + len(first.frame.joined) if first is not None else 0
        self._waiting = [deque() for _ in range(count)]
        for posed in self._whole:
            self._give(posed)
        return first

    def whole(self) -> Iterator[PosedFrame]:
        """Yield the frames unchanged."""
        while self._whole or self._draw():
            yield self._whole.popleft()

    def of(self, lidar: int) -> Iterator[PosedFrame]:
        """Yield the frames of one lidar, 0 the main one, each in its own space with its pose."""
        waiting = self._waiting[lidar]
        while waiting or self._draw():
            if waiting:
                yield waiting.popleft()

    def _draw(self) -> bool:
        posed = next(self._frames, None)
        if posed is None:
            return False
        self._whole.append(posed)
        if self._waiting:
            self._give(posed)
        return True

    def _give(self, posed: PosedFrame) -> None:
        frame = posed.frame
        if not frame.joined:
            return
        self._waiting[0].append(replace(posed, frame=frame.main()))
        for number, lidar in enumerate(frame.joined):
            if lidar.points:
                own = lidar_frame(frame, number)
                pose = posed.odom_from_sensor @ lidar.main_from_lidar
                self._waiting[number + 1].append(replace(posed, frame=own, odom_from_sensor=pose))


def _joined(said: list[FrameLabels]) -> FrameLabels:
    """Append the labels of further lidars to those of the main one, whose health counts."""
    class_ids = [each.class_id for each in said if each.class_id is not None]
    return FrameLabels(
        labels=np.concatenate([each.labels for each in said]),
        confidence=np.concatenate([each.confidence for each in said]),
        class_id=np.concatenate(class_ids) if len(class_ids) == len(said) else None,
        health=said[0].health,
    )
