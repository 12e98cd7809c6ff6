"""Frames that wait for later ones: what leaves its place moves, but it takes time to see."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame
from schemas.labels import FrameHealth, FrameLabels
from workers.lidar.beam_table import BeamTable
from workers.lidar.preprocessing import Prepared
from workers.selfsupervised.history import PastFrame

LOOKAHEADS_S: Final = (0.0, 0.5, 1.0)
"""None, what slow cars need, and what people on foot need to leave their place."""

_TOLERANCE_NS: Final = NS_PER_S // 20
"""Half a revolution at 10 Hz: the frame closest to the end of the wait ends it."""

_MOST_FRAMES: Final = 24
"""As many as are remembered of the past, however fast the sensor."""


@dataclass(frozen=True, slots=True, eq=False)
class Ready:
    """A frame that can be compared, and what other frames may ask of it.

    Attributes:
        prepared: What it was turned into.
        seen: What others ask.
        table: Beams of the sensor as they were known then; later frames may teach others.
        sensor_height_m: Of the origin of the beams over the road, as it was known then.
        blind: Why nothing can be judged in it all the same; None where it can.
    """

    prepared: Prepared
    seen: PastFrame
    table: BeamTable
    sensor_height_m: float
    blind: FrameHealth | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Waiting:
    """A frame that is not answered yet.

    Attributes:
        frame: As it came.
        content: What it was turned into; or its labels, where it cannot be compared.
        anew: What was before it cannot be compared with it.
        apart: It does not fit the frame before it, so that one of the two poses is wrong.
    """

    frame: LidarFrame
    content: Ready | FrameLabels
    anew: bool = False
    apart: bool = False


class Ahead:
    """Holds frames back until those up to a lookahead later were seen; none without one."""

    def __init__(self, lookahead_s: float) -> None:
        self._lookahead_ns = round(lookahead_s * NS_PER_S)
        self._frames: deque[Waiting] = deque()

    def add(self, frame: Waiting) -> Iterator[tuple[Waiting, Sequence[PastFrame]]]:
        """Take a frame in.

        Yields:
            Those that wait no longer, in order, each with the later frames that it may ask.
        """
        if frame.anew or frame.apart:
            yield from self.flush()
        self._frames.append(frame)
        newest_ns = frame.frame.stamp_ns
        while self._frames and (
            newest_ns - self._frames[0].frame.stamp_ns >= self._lookahead_ns - _TOLERANCE_NS
            or len(self._frames) > _MOST_FRAMES
        ):
            yield self._next()

    def flush(self) -> Iterator[tuple[Waiting, Sequence[PastFrame]]]:
        """Let all go: the log ends, or begins anew."""
        while self._frames:
            yield self._next()

    def _next(self) -> tuple[Waiting, Sequence[PastFrame]]:
        first = self._frames.popleft()
        later = [each.content.seen for each in self._frames if isinstance(each.content, Ready)]
        return first, later
