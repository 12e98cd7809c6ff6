"""The default self-supervised stream: clusters registered over time, verified by free space."""

from collections.abc import Iterable, Iterator
from typing import ClassVar

from schemas.frame import PosedFrame
from schemas.labels import FrameLabels
from schemas.task import MOTION, Task
from workers.part_version import version_of
from workers.selfsupervised.lookahead_buffer import LOOKAHEADS_S, LookaheadBuffer
from workers.selfsupervised.state import StreamState


class Registration:
    """Motion without labels or learned weights, from past frames only unless it looks ahead.

    Each cluster of points off the ground is registered to the frames 0.1 s and 0.5 s ago. A motion
    counts only if free space confirms it: its place was seen through before, or the place that it
    left is seen through now. Free space alone may also decide, from the votes of the last second,
    and of the next one within the lookahead. All points are UNKNOWN in the first half second, after
    a gap, and where the pose is lost.
    """

    task: ClassVar[Task] = MOTION
    class_names: tuple[str, ...] = ()

    def __init__(self, lookahead_s: float = 0.0) -> None:
        """Build the stream.

        Args:
            lookahead_s: Longest wait of labels for later frames, which stay in memory until then.

        Raises:
            ValueError: If it is not one of 0, 0.5 and 1.
        """
        if lookahead_s not in LOOKAHEADS_S:
            raise ValueError(f"lookahead must be one of {LOOKAHEADS_S} s, got {lookahead_s:g}")
        self.lookahead_s = lookahead_s

    @property
    def version(self) -> str:
        """`registration@digest` of code, libraries and lookahead."""
        return version_of("registration", f"lookahead_s={self.lookahead_s:g}")

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order, at once or after the lookahead."""
        state, buffer = (
            StreamState(looks_ahead=self.lookahead_s > 0.0),
            LookaheadBuffer(self.lookahead_s),
        )
        for posed in frames:
            for waiting, later in buffer.add(state.prepare(posed)):
                yield state.label(waiting, later)
        for waiting, later in buffer.flush():
            yield state.label(waiting, later)
