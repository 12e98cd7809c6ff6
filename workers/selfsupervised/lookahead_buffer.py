"""Lookahead buffer: frames wait for later ones, which show what leaves its place."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame
from schemas.labels import FrameHealth, FrameLabels
from workers.lidar.beam_table import BeamTable
from workers.lidar.preprocessing import PreprocessedFrame
from workers.selfsupervised.history import PastFrame

LOOKAHEADS_S: Final = (0.0, 0.5, 1.0)
"""Selectable lookaheads, seconds: none, enough for slow cars, and enough for pedestrians."""

_TOLERANCE_NS: Final = NS_PER_S // 20
"""Tolerance at the end of the lookahead: half a revolution at 10 Hz."""

_MOST_FRAMES: Final = 24
"""Frames that wait at most, at any sensor rate; the history has the same limit."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparableFrame:
    """A frame that can be compared, with its state for comparisons by other frames.

    Attributes:
        prepared: The preprocessed frame.
        seen: Its entry in the history.
        table: Beams of the sensor known at that time; later frames may change them.
        sensor_height_m: Height of the origin of the beams over the road, known at that time.
        blind: Reason for which nothing in it can be labelled; None where labels are possible.
    """

    prepared: PreprocessedFrame
    seen: PastFrame
    table: BeamTable
    sensor_height_m: float
    blind: FrameHealth | None = None


@dataclass(frozen=True, slots=True, eq=False)
class BufferedFrame:
    """A frame that waits for its labels.

    Attributes:
        frame: The frame of the log.
        content: The prepared frame; or its labels, where it cannot be compared.
        restarts: The frames before it cannot be compared with it.
        disconnected: It does not fit the frame before it, so that one of the two poses is wrong.
    """

    frame: LidarFrame
    content: ComparableFrame | FrameLabels
    restarts: bool = False
    disconnected: bool = False


class LookaheadBuffer:
    """Delays frames until all frames within the lookahead have arrived; 0 s is no delay."""

    def __init__(self, lookahead_s: float) -> None:
        self._lookahead_ns = round(lookahead_s * NS_PER_S)
        self._frames: deque[BufferedFrame] = deque()

    def add(self, frame: BufferedFrame) -> Iterator[tuple[BufferedFrame, Sequence[PastFrame]]]:
        """Add a frame.

        Yields:
            Frames that wait no longer, in order, each with the later frames available to it.
        """
        if frame.restarts or frame.disconnected:
            yield from self.flush()
        self._frames.append(frame)
        newest_ns = frame.frame.stamp_ns
        while self._frames and (
            newest_ns - self._frames[0].frame.stamp_ns >= self._lookahead_ns - _TOLERANCE_NS
            or len(self._frames) > _MOST_FRAMES
        ):
            yield self._next()

    def flush(self) -> Iterator[tuple[BufferedFrame, Sequence[PastFrame]]]:
        """Yield all waiting frames, at the end of the log or of a comparable stretch."""
        while self._frames:
            yield self._next()

    def _next(self) -> tuple[BufferedFrame, Sequence[PastFrame]]:
        first = self._frames.popleft()
        later = [
            each.content.seen for each in self._frames if isinstance(each.content, ComparableFrame)
        ]
        return first, later
