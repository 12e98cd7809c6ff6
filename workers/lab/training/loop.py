"""Training loop of any network: steps, scores, early stop, and a state to go on from."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import torch
from torch import Tensor

from workers.lab.training.errors import TrainingDivergedError
from workers.lab.training.run_state import Progress, read_state, write_state

_RISING: Final = 0.15
"""Share of the steps in which a rate rises that rises and falls once."""

STATE_EVERY_S: Final = 20.0
"""Interval of the states, seconds: the most that a kill loses."""


class Learner(Protocol):
    """One network with its data and its loss."""

    @property
    def name(self) -> str:
        """Name of the network in messages."""
        ...

    @property
    def net(self) -> torch.nn.Module:
        """The network, on its device."""
        ...

    def start_step(self, step: int) -> None:
        """Set the network's modes for a step, counted from 1."""
        ...

    def loss(self, rng: np.random.Generator) -> Tensor:
        """Draw data and compute the loss, a scalar."""
        ...

    def scores(self) -> tuple[float, dict[str, float]]:
        """Score held-out data: the score that decides (higher is better; NaN: none), and all."""
        ...


@dataclass(frozen=True, slots=True)
class Schedule:
    """Optimiser, learning rates and length of a run.

    Attributes:
        optimiser: Updates the parameters.
        rates: Changes the learning rate after each step.
        steps: Number of steps.
        scorings: Number of scorings, evenly spaced; each may be the last by `patience`.
        patience: Scorings without a better score after which the run stops; 0: never.
    """

    optimiser: torch.optim.Optimizer
    rates: torch.optim.lr_scheduler.LRScheduler
    steps: int
    scorings: int
    patience: int


def rising_and_falling(
    optimiser: torch.optim.Optimizer, *, peak_rate: float, steps: int
) -> torch.optim.lr_scheduler.LRScheduler:
    """Return rates that rise to the highest in the first 15 % of the steps, and fall after it."""
    return torch.optim.lr_scheduler.OneCycleLR(
        optimiser, max_lr=peak_rate, total_steps=steps, pct_start=_RISING
    )


def run(
    learner: Learner,
    schedule: Schedule,
    *,
    rng: np.random.Generator,
    state: Path | None = None,
    keep: Callable[[Progress], None] = lambda progress: None,
    on_step: Callable[[int], None] = lambda step: None,
) -> Progress:
    """Run the steps that are left, and leave the kept parameters in the network.

    Args:
        learner: The network with its data.
        schedule: Optimiser and length.
        rng: Source of everything drawn with numpy; torch has its own.
        state: File to go on from and to write to; None: the run cannot be resumed.
        keep: Called after each scoring with parameters to keep.
        on_step: Called with the number of steps done.

    Returns:
        Progress at the end.

    Raises:
        TrainingDivergedError: If a loss is not finite; the weights of the last scoring were kept.
        ResumeRefusedError: If the state cannot be read.
        StateUnwritableError: If it cannot be written.
    """
    parts = {"net": learner.net, "optimiser": schedule.optimiser, "schedule": schedule.rates}
    done = Progress() if state is None else read_state(state, **parts, rng=rng)  # type: ignore[arg-type]
    every = max(math.ceil(schedule.steps / schedule.scorings), 1)
    written_s = time.monotonic()
    on_step(done.step)
    while done.step < schedule.steps and not _is_stopped(done, schedule, every):
        step = done.step + 1
        learner.net.train()
        learner.start_step(step)
        loss = learner.loss(rng)
        if not torch.isfinite(loss):
            raise TrainingDivergedError(_diverged(learner.name, step, done))
        schedule.optimiser.zero_grad()
        torch.autograd.backward(loss)
        schedule.optimiser.step()
        schedule.rates.step()
        total, count = done.losses
        done.losses, done.step = (total + float(loss.detach()), count + 1), step
        if step % every == 0 or step == schedule.steps:
            _score(learner, done)
            if done.best_step == step:
                keep(done)
        if state is not None and (
            time.monotonic() - written_s > STATE_EVERY_S or step % every == 0
        ):
            write_state(state, done, **parts, rng=rng)  # type: ignore[arg-type]
            written_s = time.monotonic()
        on_step(step)
    if done.kept:
        learner.net.load_state_dict(done.kept)
    return done


def _is_stopped(done: Progress, schedule: Schedule, every: int) -> bool:
    """Return True if the best score lies too many scorings back."""
    return bool(
        schedule.patience and done.kept and done.step - done.best_step >= schedule.patience * every
    )


def _score(learner: Learner, done: Progress) -> None:
    """Score the network, and keep its parameters if they are the best or there is no score."""
    learner.net.eval()
    score, scores = learner.scores()
    total, count = done.losses
    done.curve.append((done.step, total / max(count, 1), score))
    done.losses = (0.0, 0)
    if math.isnan(score) or score > done.best:
        done.best = score if not math.isnan(score) else done.best
        done.best_step, done.scores = done.step, scores
        done.kept = {
            name: value.detach().cpu().clone() for name, value in learner.net.state_dict().items()
        }


def _diverged(name: str, step: int, done: Progress) -> str:
    kept = (
        f"the weights of step {done.best_step} were kept"
        if done.kept
        else "no weights were written, because none were scored before"
    )
    return (
        f"the loss of {name} is not a number in step {step}: {kept}; try a lower --peak-rate, or "
        "look for values in the data that are no measurements"
    )


def curve_text(done: Progress) -> str:
    """Return the curve for a card: `step: loss/score` for each scoring."""
    return ", ".join(
        f"{step}: {loss:.4f}" + ("" if math.isnan(score) else f"/{score:.4f}")
        for step, loss, score in done.curve
    )
