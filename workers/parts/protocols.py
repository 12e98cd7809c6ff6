"""What each replaceable part of the pipeline does: an iterator in, an iterator out.

A part may keep state over the frames of one shard, hold back frames that it needs to look ahead,
and still use bounded memory. It yields exactly one answer per frame, in order.
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
    """Says where the sensor was at each frame."""

    @property
    def version(self) -> str:
        """`name@digest` of everything that changes its output."""
        ...

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        """Yield each frame with its pose, in order; state begins anew with every call."""
        ...


class Stream(Protocol):
    """One way to label points with the classes of a task; motion is the first one."""

    @property
    def task(self) -> Task:
        """What it answers about every point: `FrameLabels.labels` index its classes."""
        ...

    @property
    def version(self) -> str:
        """`name@digest` of everything that changes its output: code, weights, settings."""
        ...

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names that `FrameLabels.class_id` indexes; empty when the stream knows no classes."""
        ...

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order; state begins anew with every call."""
        ...


class Witness(Protocol):
    """A third opinion on motion, which sees what both streams said, and what came after."""

    @property
    def version(self) -> str:
        """`name@digest` of everything that changes its output."""
        ...

    def __call__(self, frames: Iterable[LabelledFrame]) -> Iterator[LabelledFrame]:
        """Yield each frame with what it says of it, in order; state begins anew every time."""
        ...


class NoWitness:
    """Nobody is asked."""

    version = "none"

    def __call__(self, frames: Iterable[LabelledFrame]) -> Iterator[LabelledFrame]:
        """Yield the frames as they come."""
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
        """Refuse two streams that answer different questions."""
        said, other = self.supervised.task, self.selfsupervised.task
        if said != other:
            raise TasksDifferError(
                f"the supervised stream answers the task {said.name}, the self-supervised one "
                f"{other.name}: they have nothing to contradict each other about; choose two of "
                "one task, which `counterpoint parts` lists"
            )

    @property
    def task(self) -> Task:
        """What both streams answer."""
        return self.supervised.task
