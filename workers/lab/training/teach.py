"""Adapts and trains SalsaNext and LMNet: data, weights with their card, and a work folder."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final, Literal

import torch

from schemas.mining import MiningSettings
from workers.lab.datasets.classes import CLASS_NAMES, ClassTable, meanings
from workers.lab.datasets.layouts import PROFILE, RESIDUAL
from workers.lab.training.batches import TrainingSet
from workers.lab.training.data import (
    TEACHER,
    DataPlan,
    DataSettings,
    LearningData,
    measured_profile,
)
from workers.lab.training.errors import NO_ROOM, StateUnwritableError, TrainingDataError
from workers.lab.training.run_state import Progress, clear, open_request
from workers.lab.training.segmentation import train
from workers.lab.training.settings import (
    PUBLISHED_EPOCHS,
    PUBLISHED_WIDTH,
    TrainingSettings,
    published_settings,
)
from workers.lab.training.warm_start import file_of
from workers.lidar.range_image import CHANNELS, Channel
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.weights import LoadedWeights, WeightsCard, load_weights

Network = Literal["salsanext", "lmnet"]
NETWORKS: Final[tuple[Network, ...]] = ("lmnet", "salsanext")

WORK: Final = "training"
"""Folder of an unfinished run, in that of the weights."""

WITHOUT_INTENSITY: Final[tuple[Channel, ...]] = ("range", "x", "y", "z")
"""Input channels. Intensity is absent: its scale differs tenfold between sensors."""

_STREETS: Final = "simulated streets of Counterpoint"
_ONE_AGE: Final = ResidualSettings(ages_s=(0.1,), max_range_m=100.0)
"""Residuals of images for a network that sees none."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Facts for the card that no program can know.

    Attributes:
        command: The command that made the weights.
        attribution: Source of the logs.
        licence: Licence of the logs.
    """

    command: str
    attribution: str = ""
    licence: str = ""


@dataclass(frozen=True, slots=True)
class Taught:
    """One network that was trained.

    Attributes:
        network: Name of the network.
        path: Its `.safetensors` file.
        digest: Hex sha256 of weights and card.
        steps: Steps done; fewer than asked where it stopped early.
        progress: Curve and scores.
    """

    network: str
    path: Path
    digest: str
    steps: int
    progress: Progress


OnProgress = Callable[[str, int, int], None]
"""Called with what is done, the number done, and the number in all."""


def adapt(
    data: DataSettings,
    mining: MiningSettings,
    settings: TrainingSettings,
    *,
    initial: Path,
    out: Path,
    origin: Origin,
    networks: Sequence[Network] = NETWORKS,
    restart: bool = False,
    on_progress: OnProgress = lambda what, done, total: None,
) -> list[Taught]:
    """Adapt networks to logs without labels, by what the self-supervised stream proved.

    Args:
        data: Logs and replays.
        mining: Ingest settings and odometry.
        settings: The schedule.
        initial: Folder of the weights to adapt.
        out: Folder for the weights.
        origin: Facts for the card.
        networks: Networks to adapt.
        restart: Give up an unfinished run in the folder that had other data or settings.
        on_progress: Called while images are built and steps are done.

    Raises:
        ResumeRefusedError: If an unfinished run in the folder has other data or settings.
        TrainingDataError: If there is nothing to learn from.
        TrainingDivergedError: If a loss is not finite; the last good weights were kept.
        WeightsUnusableError: If initial weights are missing or damaged.
    """
    loaded = {name: load_weights(initial / f"{name}.safetensors") for name in networks}
    first = loaded[networks[0]]
    residual = next((each.residual for each in loaded.values() if each.residual), _ONE_AGE)
    plan = DataPlan(data, mining)
    work = out / WORK
    request = {
        "command": "adapt",
        "networks": list(networks),
        "initial weights": {name: each.digest for name, each in loaded.items()},
        **schedule_facts(settings),
        **plan.request(),
    }
    with disk_sentences(out):
        open_request(work, request, restart=restart)
        made = plan.build(
            work,
            profile=replace(first.profile, name=first.profile.name),
            residual=residual,
            motion="lmnet" in networks,
            on_progress=lambda done, total: on_progress("labels and images", done, total),
        )
        if not made.logs:
            raise TrainingDataError(f"no log gave a frame to learn from ({data.bucket})")
        taught = []
        for name, each in loaded.items():
            replays = name == "lmnet" or _is_coarse(each)
            sets = made.training_sets(replay_share=data.replay_share, replays=replays)
            _need_proof(sets, each.card, data.bucket)
            card = each.card.model_copy(
                update={
                    "teacher": "selfsupervised",
                    "attribution": attribution_of(origin, data, before=each.card.attribution),
                    "data_license": licence_of(origin, before=each.card.data_license),
                    "training": {
                        **_facts(settings, data, made, origin, each),
                        "labels": f"proved by {TEACHER}",
                    },
                    "scores": {},
                }
            )
            taught.append(_taught(sets, made, card, settings, out, each, on_progress=on_progress))
        clear(work)
    return taught


def train_network(
    network: Network,
    data: DataSettings,
    mining: MiningSettings,
    settings: TrainingSettings,
    *,
    out: Path,
    origin: Origin,
    initial: Path | None = None,
    classes: ClassTable | None = None,
    width: int = 8,
    epochs: int = 0,
    restart: bool = False,
    on_progress: OnProgress = lambda what, done, total: None,
) -> Taught:
    """Train a network on the truth of logs, on simulated streets, or on both.

    Args:
        network: Its name.
        data: Logs with truth, and streets.
        mining: Ingest settings and odometry.
        settings: The schedule; with `published` its steps follow from the images.
        out: Folder for the weights.
        origin: Facts for the card.
        initial: Folder or file of weights to continue from; None: random ones.
        classes: Classes of a semantic network; None: the coarse ones.
        width: Channels of the first stage.
        epochs: Epochs of the published schedule; 0: as published.
        restart: Give up an unfinished run in the folder that had other data or settings.
        on_progress: Called while images are built and steps are done.

    Raises:
        As `adapt`; TruthUnusableError: If truth is missing, or does not fit its logs.
    """
    table = classes or ClassTable()
    loaded = None if initial is None else load_weights(file_of(initial, network))
    base = _base_card(network, table, settings, width, loaded)
    plan = DataPlan(data, mining, table)
    work = out / WORK
    request = {
        "command": f"train {network}",
        "initial weights": None if loaded is None else loaded.digest,
        "width": base.width,
        "classes": [each.name for each in base.classes],
        "epochs": epochs if settings.published else 0,
        **schedule_facts(settings),
        **plan.request(),
    }
    with disk_sentences(out):
        open_request(work, request, restart=restart)
        made = plan.build(
            work,
            profile=base.profile,
            residual=base.residual or _ONE_AGE,
            motion=network == "lmnet",
            on_progress=lambda done, total: on_progress("labels and images", done, total),
        )
        replays = network == "lmnet" or tuple(each.name for each in base.classes) == CLASS_NAMES
        sets = made.training_sets(replay_share=data.replay_share, replays=replays)
        if not sets:
            raise TrainingDataError(
                "streets and replayed logs have the coarse classes; own classes need --logs"
            )
        if settings.published:
            images = sum(len(each.images.channels) for each in sets)
            settings = published_settings(
                settings, images=images, epochs=epochs or PUBLISHED_EPOCHS
            )
        card = base.model_copy(
            update={
                "profile": base.profile if loaded else measured_profile(sets, base.profile),
                "attribution": attribution_of(
                    origin, data, before="" if loaded is None else loaded.card.attribution
                ),
                "data_license": licence_of(
                    origin, before="" if loaded is None else loaded.card.data_license
                ),
                "training": {
                    **_facts(settings, data, made, origin, loaded),
                    "labels": f"truth of {data.truth}" if data.truth else "simulated",
                },
            }
        )
        taught = _taught(sets, made, card, settings, out, loaded, on_progress=on_progress)
        clear(work)
    return taught


def need_free(out: Path, networks: Sequence[str], *, force: bool) -> None:
    """Refuse to replace weights, unless an unfinished run in the folder wrote them.

    Raises:
        TrainingDataError: If there are weights.
    """
    if force or (out / WORK).is_dir():
        return
    for name in networks:
        if (path := out / f"{name}.safetensors").exists():
            raise TrainingDataError(
                f"weights lie there: name another folder, or replace them with --force ({path})"
            )


def _taught(
    sets: Sequence[TrainingSet],
    made: LearningData,
    card: WeightsCard,
    settings: TrainingSettings,
    out: Path,
    initial: LoadedWeights | None,
    *,
    on_progress: OnProgress,
) -> Taught:
    path = out / f"{card.network}.safetensors"
    judged = made.judged() if made.logs else {}
    if tuple(each.name for each in card.classes) != CLASS_NAMES and made.proved:
        judged = judged if card.network == "lmnet" or any(m.movable for m in card.classes) else {}
    done = train(
        sets,
        judged,
        card,
        settings,
        out=path,
        initial=initial,
        state=out / WORK / f"{card.network}.state",
        on_step=lambda step: on_progress(card.network, step, settings.steps),
    )
    return Taught(card.network, path, load_weights(path).digest, done.step, done)


def _base_card(
    network: Network,
    table: ClassTable,
    settings: TrainingSettings,
    width: int,
    initial: LoadedWeights | None,
) -> WeightsCard:
    if initial is not None:
        card = initial.card
        named = [each.name for each in card.classes]
        if network == "salsanext" and named != [each.name for each in table.meanings]:
            raise TrainingDataError(
                f"the initial weights answer other classes than --classes says: {', '.join(named)}"
            )
        return card.model_copy(update={"scores": {}})
    published = settings.published
    return WeightsCard(
        network=network,
        classes=meanings("lmnet") if network == "lmnet" else table.meanings,
        width=PUBLISHED_WIDTH if published else width,
        profile=replace(PROFILE, columns=2048) if published else PROFILE,
        channels=CHANNELS if published else WITHOUT_INTENSITY,
        residual=None
        if network == "salsanext"
        else (ResidualSettings() if published else RESIDUAL),
        attribution="",
        data_license="",
    )


def schedule_facts(settings: TrainingSettings) -> dict[str, object]:
    """Return the settings that decide the weights, for the request of a run."""
    return {**asdict(settings), "torch": torch.__version__}


def _facts(
    settings: TrainingSettings,
    data: DataSettings,
    made: LearningData,
    origin: Origin,
    initial: LoadedWeights | None,
) -> dict[str, str | int | float]:
    """Return what was really used, for the card."""
    logs: dict[str, int] = {}
    for each in made.logs:
        logs[each.source] = logs.get(each.source, 0) + len(each)
    named = [f"{log} ({frames} frames)" for log, frames in logs.items()]
    if len(named) > _NAMED_LOGS:
        named = [*named[:_NAMED_LOGS], f"and {len(named) - _NAMED_LOGS} more logs"]
    return {
        **asdict(settings),
        "command": origin.command,
        "learnt": "; ".join(named) or "no logs",
        "held_out": "; ".join(dict.fromkeys(each.source for each in made.held_out)) or "nothing",
        "replayed": "; ".join(dict.fromkeys(each.source for each in made.replayed)) or "nothing",
        "streets": data.streets,
        "replay_share": data.replay_share,
        "initial": "" if initial is None else initial.digest,
        "torch": torch.__version__,
    }


_NAMED_LOGS: Final = 20
"""Logs that a card names; a sidecar has one megabyte at most."""


def attribution_of(origin: Origin, data: DataSettings, *, before: str) -> str:
    """Return the sources of initial weights, logs and streets, for the card."""
    said = [before, origin.attribution or (f"logs of {data.bucket}" if data.bucket else "")]
    said += [_STREETS if data.streets and _STREETS not in before else ""]
    said += [f"replayed logs of {folder.name}" for folder in data.replay]
    return "; ".join(each for each in said if each)


def licence_of(origin: Origin, *, before: str) -> str:
    """Return the licences of initial weights and logs, for the card."""
    said = [before, origin.licence or "licence of the logs: not stated by who trained"]
    return "; ".join(each for each in said if each)


def _is_coarse(loaded: LoadedWeights) -> bool:
    return tuple(each.name for each in loaded.card.classes) == CLASS_NAMES


def _need_proof(sets: Sequence[TrainingSet], card: WeightsCard, bucket: str) -> None:
    """Refuse logs in which nothing was proved to move: a network would learn that nothing does."""
    if not any((each.images.motion == 2).any() for each in sets if each.proved):
        raise TrainingDataError(
            f"the self-supervised stream proved nothing to move in the chosen frames: "
            f"{card.network} would learn that nothing does; name more logs or --images ({bucket})"
        )


@contextmanager
def disk_sentences(out: Path) -> Iterator[None]:
    """Say in a sentence that a disk is full while images are written."""
    try:
        yield
    except OSError as error:
        if error.errno not in NO_ROOM:
            raise
        raise StateUnwritableError(
            f"cannot write the images of the training: {error.strerror}; free space or name "
            f"another folder, then give the same command again to go on ({error.filename or out})"
        ) from error
