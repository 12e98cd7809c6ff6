"""Protocols of the replaceable parts: each maps an iterator of frames to an iterator of results.

A part may keep state over the frames of one shard, and delay frames for lookahead, within bounded
memory. It yields exactly one result per frame, in order.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

from schemas.contradiction import LabelledFrame
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from schemas.task import Task
from workers.contradiction.settings import DEFAULT_INSTANCES, InstanceSettings
from workers.errors import TasksDifferError


class Odometry(Protocol):
    """Odometry: estimates the sensor pose of each frame."""

    @property
    def version(self) -> str:
        """`name@digest` of everything that changes its output."""
        ...

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        """Yield each frame with its pose, in order; every call starts with fresh state."""
        ...


class Stream(Protocol):
    """One way to label points with the classes of a task; motion is the first one."""

    @property
    def task(self) -> Task:
        """Task of its labels: `FrameLabels.labels` index the classes of the task."""
        ...

    @property
    def version(self) -> str:
        """`name@digest` of everything that changes its output: code, weights, settings."""
        ...

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names that `FrameLabels.class_id` indexes; empty without classes."""
        ...

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order; every call starts with fresh state."""
        ...


class Witness(Protocol):
    """Third opinion on motion, from the labels of both streams and later frames."""

    @property
    def version(self) -> str:
        """`name@digest` of everything that changes its output."""
        ...

    def __call__(self, frames: Iterable[LabelledFrame]) -> Iterator[LabelledFrame]:
        """Yield each frame with the witness's labels, in order; every call starts afresh."""
        ...


class NoWitness:
    """Witness that gives no opinion."""

    version = "none"

    def __call__(self, frames: Iterable[LabelledFrame]) -> Iterator[LabelledFrame]:
        """Yield the frames unchanged."""
        yield from frames


@dataclass(frozen=True, slots=True)
class Parts:
    """The replaceable parts of the pipeline, as chosen by name."""

    odometry: Odometry
    supervised: Stream
    selfsupervised: Stream
    witness: Witness = field(default_factory=NoWitness)
    instances: InstanceSettings = DEFAULT_INSTANCES
    own_model: str = ""
    """Name of the user's own model; empty where the supervised stream is a shipped one."""

    def __post_init__(self) -> None:
        """Refuse two streams of different tasks."""
        said, other = self.supervised.task, self.selfsupervised.task
        if said != other:
            raise TasksDifferError(
                f"the supervised stream answers the task {said.name}, the self-supervised one "
                f"{other.name}: they have nothing to contradict each other about; choose two of "
                "one task, which `counterpoint parts` lists"
            )

    @property
    def task(self) -> Task:
        """Task of both streams."""
        return self.supervised.task
