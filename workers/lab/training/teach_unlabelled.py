"""Trains networks that need no truth: files of frames, weights with their card, a work folder."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, Protocol, TypeVar

import torch
from torch import Tensor, nn

from schemas.mining import MiningSettings
from workers.checkpoints.stored_weights import Card, Stored
from workers.lab.training.collect import Maker, OnProgress, collect, split_items
from workers.lab.training.data import DataPlan, DataSettings
from workers.lab.training.errors import TrainingDataError
from workers.lab.training.run_state import Progress, clear, open_request
from workers.lab.training.settings import TrainingSettings
from workers.lab.training.teach import (
    WORK,
    Origin,
    Taught,
    attribution_of,
    disk_sentences,
    licence_of,
    schedule_facts,
)
from workers.lab.training.warm_start import file_of

Item = TypeVar("Item")
CardType = TypeVar("CardType", bound=Card)
NetType = TypeVar("NetType", bound=nn.Module)

Facts = dict[str, str | int | float]
"""Facts of a run, for its request or its card."""

STREETS: Final = "simulated streets"
"""Name of the streets among what is held out."""

_USED: Final = (
    *("steps", "batch", "peak_rate", "scorings", "patience", "seed", "threads", "device"),
    "published",
)


class Task(Protocol[Item, NetType, CardType]):
    """One network that needs no truth: what it learns from, its schedule, card and training."""

    @property
    def name(self) -> str:
        """Name of the network."""
        ...

    @property
    def labels(self) -> str:
        """Source of what is learnt, for request and card."""
        ...

    @property
    def what(self) -> str:
        """Name of its items in messages: clouds or pairs."""
        ...

    @property
    def most_judged(self) -> int:
        """Held-out items scored at most."""
        ...

    @property
    def maker(self) -> Maker:
        """Maker of its files."""
        ...

    def every(self, settings: TrainingSettings) -> int:
        """Return of how many frames one is taken."""
        ...

    def request(self, mining: MiningSettings) -> Facts:
        """Return what decides the weights in addition to data and schedule."""
        ...

    def items_of(self, files: Sequence[Path]) -> list[Item]:
        """Return the items of a stretch by its files."""
        ...

    def schedule(self, settings: TrainingSettings, *, items: int) -> TrainingSettings:
        """Return the schedule for a number of items."""
        ...

    def card(self, items: Sequence[Item], before: CardType | None) -> CardType:
        """Return a card without its origin, with the facts of a training that only it has."""
        ...

    def train(
        self,
        items: Sequence[Item],
        judged: Mapping[str, Sequence[Item]],
        card: CardType,
        settings: TrainingSettings,
        *,
        out: Path,
        initial: Mapping[str, Tensor] | None,
        state: Path,
        on_step: Callable[[int], None],
    ) -> Progress:
        """Run the schedule."""
        ...

    def load(self, path: Path) -> Stored[NetType, CardType]:
        """Load weights of the network."""
        ...


def teach(
    task: Task[Item, NetType, CardType],
    data: DataSettings,
    mining: MiningSettings,
    settings: TrainingSettings,
    *,
    out: Path,
    origin: Origin,
    initial: Path | None = None,
    restart: bool = False,
    on_progress: OnProgress = lambda what, done, total: None,
) -> Taught:
    """Train a network on logs without truth, on simulated streets, or on both.

    Args:
        task: The network.
        data: Logs, without truth, and streets.
        mining: Ingest settings and odometry.
        settings: The schedule; with a published one its steps follow from the items.
        out: Folder for the weights.
        origin: Facts for the card.
        initial: Folder or file of weights to continue from; None: random ones.
        restart: Give up an unfinished run in the folder that had other data or settings.
        on_progress: Called while files are made and steps are done.

    Raises:
        ResumeRefusedError: If an unfinished run in the folder has other data or settings.
        TrainingDataError: If there is nothing to learn from.
        TrainingDivergedError: If a loss is not finite; the last good weights were kept.
        WeightsUnusableError: If initial weights are missing or damaged.
    """
    loaded = None if initial is None else task.load(file_of(initial, task.name))
    plan, work = DataPlan(data, mining), out / WORK
    request = {
        "command": f"train {task.name}",
        "initial weights": None if loaded is None else loaded.digest,
        **schedule_facts(settings),
        **plan.request(),
        **task.request(mining),
        "labels": task.labels,
    }
    with disk_sentences(out):
        open_request(work, request, restart=restart)
        by_log, of_streets = collect(
            plan,
            work,
            task.maker,
            what=f"{task.what} of {task.name}",
            every=task.every(settings),
            on_progress=on_progress,
        )
        items_by_log = {
            log: [item for files in stretches for item in task.items_of(files)]
            for log, stretches in by_log.items()
        }
        learnt, judged = split_items(items_by_log, most=task.most_judged)
        streets = task.items_of(of_streets)
        if not items_by_log:
            # streets alone: the last of them judge
            split, judged = split_items({STREETS: streets}, most=task.most_judged)
            streets = split.get(STREETS, [])
        items = [item for found in learnt.values() for item in found] + streets
        if not items:
            raise TrainingDataError(
                f"no frame gives {task.what} of enough points to learn from "
                f"({data.bucket or 'simulated streets'})"
            )
        settings = task.schedule(settings, items=len(items))
        before = None if loaded is None else loaded.card
        made = task.card(items, before)
        card = made.model_copy(
            update={
                "attribution": attribution_of(
                    origin, data, before="" if before is None else before.attribution
                ),
                "data_license": licence_of(
                    origin, before="" if before is None else before.data_license
                ),
                "training": {
                    **{name: getattr(settings, name) for name in _USED},
                    **made.training,
                    "command": origin.command,
                    "labels": task.labels,
                    "learnt": f"{len(items) - len(streets)} {task.what} of {len(learnt)} logs",
                    "held_out": f"{sum(map(len, judged.values()))} {task.what}",
                    "streets": f"{len(streets)} {task.what} of {data.streets} streets",
                    "initial": "" if loaded is None else loaded.digest,
                    "torch": torch.__version__,
                },
            }
        )
        path, steps = out / f"{task.name}.safetensors", settings.steps
        done = task.train(
            items,
            judged,
            card,
            settings,
            out=path,
            initial=None if loaded is None else loaded.net.state_dict(),
            state=work / f"{task.name}.state",
            on_step=lambda step: on_progress(task.name, step, steps),
        )
        clear(work)
    return Taught(task.name, path, task.load(path).digest, done.step, done)
