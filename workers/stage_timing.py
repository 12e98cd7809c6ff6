"""Stage timing: seconds of a shard per stage, though stages run interleaved, frame by frame."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

from schemas.contradiction import LabelledFrame
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from schemas.task import Task
from workers.parts.protocols import Odometry, Parts, Stream, Witness

Stage = Literal[
    "ingest",
    "odometry",
    "supervised",
    "selfsupervised",
    "witness",
    "contradiction",
    "pictures",
    "encoding",
    "rescoring",
    "publishing",
    "committing",
]
"""Every stage, as the label of a metric."""

Item = TypeVar("Item")


class StageClock:
    """Adds up the seconds of each stage, without those of the stages it draws its input from.

    Stages are generators that draw on each other, so the time of a `next` also includes every
    stage upstream. A stack of the stages being drawn assigns each second to the innermost one.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: dict[Stage, float] = defaultdict(float)
        self._clock = clock
        self._stack: list[Stage] = []
        self._since_s = clock()

    @contextmanager
    def stage(self, name: Stage) -> Iterator[None]:
        """Assign the time inside to this stage, except that of stages entered from within."""
        self._switch()
        self._stack.append(name)
        try:
            yield
        finally:
            self._switch()
            self._stack.pop()

    def drawn(self, name: Stage, items: Iterable[Item]) -> Iterator[Item]:
        """Pass items through, and assign the time to draw each one to this stage."""
        iterator = iter(items)
        while True:
            with self.stage(name):
                try:
                    item = next(iterator)
                except StopIteration:
                    return
            yield item

    def _switch(self) -> None:
        now_s = self._clock()
        if self._stack:
            self.seconds[self._stack[-1]] += now_s - self._since_s
        self._since_s = now_s


@dataclass(frozen=True, slots=True)
class _TimedOdometry:
    inner: Odometry
    clock: StageClock

    @property
    def version(self) -> str:
        return self.inner.version

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        return self.clock.drawn("odometry", self.inner(frames))


@dataclass(frozen=True, slots=True)
class _TimedStream:
    name: Stage
    inner: Stream
    clock: StageClock

    @property
    def task(self) -> Task:
        return self.inner.task

    @property
    def version(self) -> str:
        return self.inner.version

    @property
    def class_names(self) -> tuple[str, ...]:
        return self.inner.class_names

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        return self.clock.drawn(self.name, self.inner(frames))


@dataclass(frozen=True, slots=True)
class _TimedWitness:
    inner: Witness
    clock: StageClock

    @property
    def version(self) -> str:
        return self.inner.version

    def __call__(self, frames: Iterable[LabelledFrame]) -> Iterator[LabelledFrame]:
        return self.clock.drawn("witness", self.inner(frames))


def timed(parts: Parts, clock: StageClock) -> Parts:
    """Return the same parts, with the clock watching them."""
    return replace(
        parts,
        odometry=_TimedOdometry(parts.odometry, clock),
        supervised=_TimedStream("supervised", parts.supervised, clock),
        selfsupervised=_TimedStream("selfsupervised", parts.selfsupervised, clock),
        witness=_TimedWitness(parts.witness, clock),
    )
