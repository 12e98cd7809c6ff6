"""Which implementations exist for each replaceable part: plain tables, loaded when chosen."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

from schemas.mining import LOOKAHEAD
from schemas.task import GROUND, MOTION, Task
from workers.contradiction.settings import DEFAULT_INSTANCES, PAPER_INSTANCES, InstanceSettings
from workers.errors import UnknownPartError
from workers.paper.scene_flow import LEARNED_FLOWS, SCENE_FLOWS
from workers.parts.files import PartFiles, all_there, weights_of
from workers.parts.protocols import NoWitness, Odometry, Parts, Stream, Witness


def _kiss_icp(_: PartFiles) -> Odometry:
    from workers.odometry.odometry import KissOdometry

    return KissOdometry()


def _delora(files: PartFiles) -> Odometry:
    from workers.paper.delora_odometry import DeLORAOdometry

    return DeLORAOdometry.load(weights_of(files, "odometry", "delora"))


def _salsanext_lmnet(files: PartFiles, *, published: bool = False) -> Stream:
    from workers.lidar.fidelity import Form
    from workers.supervised.stream import SHIPPED, RangeImageStream

    folder = Path(files.weights) if files.weights else SHIPPED
    form = Form.PAPER if published else Form.CORRECTED
    return RangeImageStream.salsanext_lmnet(folder, form=form)


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
    from workers.selfsupervised.stream import Registration
    from workers.warmup.jit_warmup import compile_apart

    compile_apart()
    return Registration(lookahead_s)


def _two_stage(files: PartFiles, *, flow: str, published: bool = False) -> Stream:
    from workers.paper.two_stage import TwoStage
    from workers.paper.two_stage_clustering import PAPER, PER_SECOND

    rule = PAPER if published else PER_SECOND
    if flow not in LEARNED_FLOWS:
        return TwoStage(flow, rule)
    weights = weights_of(files, "self-supervised stream", f"two-stage:{flow}")
    return TwoStage(flow, rule, LEARNED_FLOWS[flow](weights))


def _two_stage_tracked(_: PartFiles, *, published: bool = False) -> Stream:
    from workers.paper.two_stage_clustering import PAPER, PER_SECOND
    from workers.paper.two_stage_tracked import TrackedTwoStage

    return TrackedTwoStage(PAPER if published else PER_SECOND)


def _ground(_: PartFiles) -> Stream:
    from workers.selfsupervised.ground_stream import GroundStream

    return GroundStream()


def _paper(files: PartFiles) -> Stream:
    from workers.paper.paper_chain import PaperChain

    return PaperChain.load(weights_of(files, "self-supervised stream", "paper"))


_FLOWS: Final = (*SCENE_FLOWS, *LEARNED_FLOWS)

ODOMETRIES: Final[Mapping[str, Callable[[PartFiles], Odometry]]] = {
    "kiss-icp": _kiss_icp,
    "delora": _delora,
}
SUPERVISED: Final[Mapping[str, Callable[[PartFiles], Stream]]] = {
    "salsanext-lmnet": _salsanext_lmnet,
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
    all_there(files, odometry, supervised, selfsupervised)
    asked = _named("witness", witness, WITNESSES)
    semantic = build_supervised(supervised, files)
    return Parts(
        odometry=build_odometry(odometry, files),
        supervised=semantic,
        selfsupervised=build_selfsupervised(selfsupervised, files),
        witness=asked() if semantic.task.moving else NoWitness(),
        instances=_named("rule of instances", instances, INSTANCES),
        own_model=semantic.version.partition("@")[0] if supervised == "own" else "",
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
