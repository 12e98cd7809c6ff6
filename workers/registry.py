"""Which implementations exist for each replaceable part: plain tables, loaded when chosen.

A part turns an iterator into an iterator, so that it may keep state over the frames of one shard,
hold back frames that it needs to look ahead, and still use bounded memory. It yields exactly one
answer per frame, in order.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final, Protocol, TypeVar

from schemas.contradiction import LabelledFrame
from schemas.frame import LidarFrame, PosedFrame
from schemas.labels import FrameLabels
from schemas.task import GROUND, MOTION, Task
from schemas.work import LOOKAHEAD
from workers.contradiction.settings import DEFAULT_INSTANCES, PAPER_INSTANCES, InstanceSettings
from workers.errors import TasksDifferError, UnknownPartError
from workers.selfsupervised.scene_flow import LEARNED_FLOWS, SCENE_FLOWS


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


@dataclass(frozen=True, slots=True)
class PartFiles:
    """What parts read beside the package.

    Attributes:
        model: Adapter of the user's own model; empty: none.
        weights: Folder of imported weights; empty: what ships.
    """

    model: str = ""
    weights: str = ""


def _kiss_icp(_: PartFiles) -> Odometry:
    from workers.selfsupervised.odometry import KissOdometry

    return KissOdometry()


def _delora(files: PartFiles) -> Odometry:
    from workers.selfsupervised.delora_odometry import DeLORAOdometry

    return DeLORAOdometry.load(_weights(files, "odometry delora"))


def _salsanext_lmnet(files: PartFiles, *, published: bool = False, folded: bool = False) -> Stream:
    from workers.geometry.form import Form
    from workers.supervised.stream import SHIPPED, RangeImageStream

    folder = Path(files.weights) if files.weights else SHIPPED
    form = Form.PAPER if published else Form.CORRECTED
    return RangeImageStream.salsanext_lmnet(folder, form=form, folded=folded)


def _salsanext_ground(files: PartFiles) -> Stream:
    from workers.supervised.stream import SHIPPED, RangeImageStream

    folder = Path(files.weights) if files.weights else SHIPPED
    return RangeImageStream.salsanext_ground(folder)


def _own(files: PartFiles) -> Stream:
    from workers.supervised.own_model import open_own_model

    if not files.model:
        raise UnknownPartError("supervised stream 'own' needs the setting model: an adapter.toml")
    return open_own_model(Path(files.model))


def _recorded(_: PartFiles, *, task: Task = MOTION) -> Stream:
    from workers.supervised.recorded import Recorded

    return Recorded(task)


def _registration(_: PartFiles, *, lookahead_s: float = 0.0) -> Stream:
    from workers.selfsupervised.compiling import compile_apart
    from workers.selfsupervised.stream import Registration

    compile_apart()
    return Registration(lookahead_s)


def _two_stage(files: PartFiles, *, flow: str, published: bool = False) -> Stream:
    from workers.selfsupervised.two_stage import TwoStage
    from workers.selfsupervised.two_stage_clustering import PAPER, PER_SECOND

    rule = PAPER if published else PER_SECOND
    if flow not in LEARNED_FLOWS:
        return TwoStage(flow, rule)
    weights = _weights(files, f"self-supervised stream two-stage:{flow}")
    return TwoStage(flow, rule, LEARNED_FLOWS[flow](weights))


def _two_stage_tracked(_: PartFiles, *, published: bool = False) -> Stream:
    from workers.selfsupervised.two_stage_clustering import PAPER, PER_SECOND
    from workers.selfsupervised.two_stage_tracked import TrackedTwoStage

    return TrackedTwoStage(PAPER if published else PER_SECOND)


def _ground(_: PartFiles) -> Stream:
    from workers.selfsupervised.ground_stream import GroundStream

    return GroundStream()


def _paper(files: PartFiles) -> Stream:
    from workers.selfsupervised.paper_chain import PaperChain

    return PaperChain.load(_weights(files, "self-supervised stream paper"))


NETWORKS_OF: Final[Mapping[str, tuple[str, ...]]] = {
    "salsanext-lmnet": ("salsanext", "lmnet"),
    "salsanext-lmnet:folded": ("salsanext", "lmnet"),
    "salsanext-lmnet:published": ("salsanext", "lmnet"),
    "salsanext:ground": ("salsanext",),
    "paper": ("gndnet", "flowstep3d"),
    "delora": ("delora",),
    **{f"two-stage:{flow}": (flow,) for flow in LEARNED_FLOWS},
    **{f"two-stage:{flow}:published": (flow,) for flow in LEARNED_FLOWS},
}
"""Whose weights a part loads; SalsaNext and LMNet ship, and are taken if no folder is named."""


def _all_there(files: PartFiles, *parts: str) -> None:
    """Name every network that the folder of weights lacks, not one after the other."""
    needed = [network for part in parts for network in NETWORKS_OF.get(part, ())]
    folder = Path(files.weights)
    if files.weights and not folder.is_dir():
        raise UnknownPartError(f"weights: there is no such folder ({folder})")
    missing = [each for each in needed if not (folder / f"{each}.safetensors").is_file()]
    if files.weights and missing:
        raise UnknownPartError(
            f"the folder of weights lacks {', '.join(missing)}, which the chosen parts need: "
            "`counterpoint weights import CHECKPOINT --network NAME --config CONFIG --out FOLDER` "
            f"for each; `counterpoint weights configs` lists those of published ones ({folder})"
        )


def _weights(files: PartFiles, part: str) -> Path:
    if not files.weights:
        networks = ", ".join(NETWORKS_OF[part.rpartition(" ")[2]])
        raise UnknownPartError(
            f"{part} needs weights that do not ship ({networks}): import them with `counterpoint "
            "weights import` and name their folder in the setting weights"
        )
    return Path(files.weights)


_FLOWS: Final = (*SCENE_FLOWS, *LEARNED_FLOWS)

ODOMETRIES: Final[Mapping[str, Callable[[PartFiles], Odometry]]] = {
    "kiss-icp": _kiss_icp,
    "delora": _delora,
}
SUPERVISED: Final[Mapping[str, Callable[[PartFiles], Stream]]] = {
    "salsanext-lmnet": _salsanext_lmnet,
    "salsanext-lmnet:folded": partial(_salsanext_lmnet, folded=True),
    "salsanext-lmnet:published": partial(_salsanext_lmnet, published=True),
    "recorded": _recorded,
    "own": _own,
    "salsanext:ground": _salsanext_ground,
    "recorded:ground": partial(_recorded, task=GROUND),
}
SELFSUPERVISED: Final[Mapping[str, Callable[[PartFiles], Stream]]] = {
    "registration": _registration,
    **{
        f"registration{LOOKAHEAD}{lookahead_s:.1f}": partial(_registration, lookahead_s=lookahead_s)
        for lookahead_s in (0.5, 1.0)
    },
    "paper": _paper,
    "two-stage": partial(_two_stage, flow="nearest-neighbour"),
    "two-stage:tracked": _two_stage_tracked,
    "two-stage:tracked:published": partial(_two_stage_tracked, published=True),
    **{f"two-stage:{flow}": partial(_two_stage, flow=flow) for flow in _FLOWS},
    **{
        f"two-stage:{flow}:published": partial(_two_stage, flow=flow, published=True)
        for flow in _FLOWS
    },
    "ground": _ground,
}
"""`two-stage:FLOW` is the rule of the paper on a scene flow, `…:published` with its numbers as
published, per frame; `two-stage` alone takes the nearest neighbour. What enters `SCENE_FLOWS`
or `LEARNED_FLOWS` is a stream of that name here."""


def _free_space() -> Witness:
    from workers.witness.free_space import TwoSidedFreeSpace

    return TwoSidedFreeSpace()


WITNESSES: Final[Mapping[str, Callable[[], Witness]]] = {
    "free-space": _free_space,
    "none": NoWitness,
}

INSTANCES: Final[Mapping[str, InstanceSettings]] = {
    "default": DEFAULT_INSTANCES,
    "paper": PAPER_INSTANCES,
}

Maker = TypeVar("Maker")


def _named(what: str, name: str, table: Mapping[str, Maker]) -> Maker:
    try:
        return table[name]
    except KeyError:
        known = ", ".join(sorted(table))
        raise UnknownPartError(f"no {what} {name!r}; known: {known}") from None


def build_parts(
    *,
    odometry: str,
    supervised: str,
    selfsupervised: str,
    witness: str = "free-space",
    instances: str = "default",
    files: PartFiles | None = None,
) -> Parts:
    """Build the parts of these names.

    Args:
        odometry: One of `ODOMETRIES`.
        supervised: One of `SUPERVISED`.
        selfsupervised: One of `SELFSUPERVISED`.
        witness: One of `WITNESSES`; nobody is asked where the task is not about motion.
        instances: One of `INSTANCES`.
        files: What they read beside the package.

    Raises:
        UnknownPartError: If one does not exist, the message lists those that do; or if it needs a
            file that is not named.
        PermanentError: If its weights or its model cannot be used.
    """
    files = files or PartFiles()
    if files.model and supervised != "own":
        raise UnknownPartError(
            f"model names your own model, but the supervised stream is {supervised}: choose it "
            f"with --supervised own; a folder of imported weights goes to --weights ({files.model})"
        )
    _all_there(files, odometry, supervised, selfsupervised)
    asked = _named("witness", witness, WITNESSES)
    semantic = build_supervised(supervised, files)
    return Parts(
        odometry=build_odometry(odometry, files),
        supervised=semantic,
        selfsupervised=build_selfsupervised(selfsupervised, files),
        witness=asked() if semantic.task.moving else NoWitness(),
        instances=_named("rule of instances", instances, INSTANCES),
    )


def build_odometry(name: str, files: PartFiles | None = None) -> Odometry:
    """Build the odometry of this name, or raise as `build_parts` does."""
    return _named("odometry", name, ODOMETRIES)(files or PartFiles())


def build_supervised(name: str, files: PartFiles | None = None) -> Stream:
    """Build the supervised stream of this name, or raise as `build_parts` does."""
    return _named("supervised stream", name, SUPERVISED)(files or PartFiles())


def build_selfsupervised(name: str, files: PartFiles | None = None) -> Stream:
    """Build the self-supervised stream of this name, or raise as `build_parts` does."""
    return _named("self-supervised stream", name, SELFSUPERVISED)(files or PartFiles())
