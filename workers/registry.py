"""Which implementations exist for each replaceable part: plain tables, loaded when chosen.

A part turns an iterator into an iterator, so that it may keep state over the frames of one shard,
hold back frames that it needs to look ahead, and still use bounded memory. It yields exactly one
answer per frame, in order.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, Protocol, TypeVar

from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from workers.errors import UnknownPartError
from workers.selfsupervised.scene_flow import SCENE_FLOWS


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
    """One way to label motion."""

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


@dataclass(frozen=True, slots=True)
class Parts:
    """The replaceable parts of the pipeline, as chosen by name."""

    odometry: Odometry
    supervised: Stream
    selfsupervised: Stream


def _kiss_icp() -> Odometry:
    from workers.selfsupervised.odometry import KissOdometry

    return KissOdometry()


def _salsanext_lmnet(model: str) -> Stream:
    from workers.supervised.stream import RangeImageStream

    return RangeImageStream.salsanext_lmnet(Path(model)) if model else RangeImageStream.shipped()


def _own(model: str) -> Stream:
    from workers.supervised.own_model import open_own_model

    if not model:
        raise UnknownPartError("supervised stream 'own' needs the setting model: an adapter.toml")
    return open_own_model(Path(model))


def _recorded(model: str) -> Stream:
    from workers.supervised.recorded import Recorded

    if model:
        raise UnknownPartError(f"recorded labels come from the log: no model is used ({model})")
    return Recorded()


def _registration() -> Stream:
    from workers.selfsupervised.stream import Registration

    return Registration()


def _two_stage(flow: str, *, published: bool = False) -> Stream:
    from workers.selfsupervised.two_stage import TwoStage
    from workers.selfsupervised.two_stage_clustering import PAPER, PER_SECOND

    return TwoStage(flow, PAPER if published else PER_SECOND)


def _two_stage_tracked(*, published: bool = False) -> Stream:
    from workers.selfsupervised.two_stage_clustering import PAPER, PER_SECOND
    from workers.selfsupervised.two_stage_tracked import TrackedTwoStage

    return TrackedTwoStage(PAPER if published else PER_SECOND)


ODOMETRIES: Final[Mapping[str, Callable[[], Odometry]]] = {"kiss-icp": _kiss_icp}
SUPERVISED: Final[Mapping[str, Callable[[str], Stream]]] = {
    "salsanext-lmnet": _salsanext_lmnet,
    "recorded": _recorded,
    "own": _own,
}
SELFSUPERVISED: Final[Mapping[str, Callable[[], Stream]]] = {
    "registration": _registration,
    "two-stage": partial(_two_stage, "nearest-neighbour"),
    "two-stage:tracked": _two_stage_tracked,
    "two-stage:tracked:published": partial(_two_stage_tracked, published=True),
    **{f"two-stage:{flow}": partial(_two_stage, flow) for flow in SCENE_FLOWS},
    **{
        f"two-stage:{flow}:published": partial(_two_stage, flow, published=True)
        for flow in SCENE_FLOWS
    },
}
"""`two-stage:FLOW` is the rule of the paper on a scene flow, `…:published` with its numbers as
published, per frame; `two-stage` alone takes the nearest neighbour. What enters `SCENE_FLOWS`
is a stream of that name here."""

Maker = TypeVar("Maker")


def _named(what: str, name: str, table: Mapping[str, Maker]) -> Maker:
    try:
        return table[name]
    except KeyError:
        known = ", ".join(sorted(table))
        raise UnknownPartError(f"no {what} {name!r}; known: {known}") from None


def build_parts(*, odometry: str, supervised: str, selfsupervised: str, model: str = "") -> Parts:
    """Build the parts of these names.

    Args:
        odometry: One of `ODOMETRIES`.
        supervised: One of `SUPERVISED`.
        selfsupervised: One of `SELFSUPERVISED`.
        model: Where the supervised stream's model lies; empty: what ships, or none.

    Raises:
        UnknownPartError: If one does not exist; the message lists those that do.
        PermanentError: If its model cannot be used.
    """
    return Parts(
        odometry=build_odometry(odometry),
        supervised=build_supervised(supervised, model=model),
        selfsupervised=build_selfsupervised(selfsupervised),
    )


def build_odometry(name: str) -> Odometry:
    """Build the odometry of this name, or raise `UnknownPartError`."""
    return _named("odometry", name, ODOMETRIES)()


def build_supervised(name: str, *, model: str = "") -> Stream:
    """Build the supervised stream of this name, or raise as `build_parts` does."""
    return _named("supervised stream", name, SUPERVISED)(model)


def build_selfsupervised(name: str) -> Stream:
    """Build the self-supervised stream of this name, or raise `UnknownPartError`."""
    return _named("self-supervised stream", name, SELFSUPERVISED)()
