"""Training of a network of the published chain: the common loop, and weights with their card."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from workers.checkpoints.stored_weights import Card, save
from workers.lab.training.loop import Learner, Schedule, curve_text, run
from workers.lab.training.run_state import Progress


def train_kept(
    learner: Learner,
    schedule: Schedule,
    card: Card,
    *,
    seed: int,
    out: Path,
    state: Path | None = None,
    on_step: Callable[[int], None] = lambda step: None,
) -> Progress:
    """Run a schedule, writing weights after each scoring that is the best so far.

    Args:
        learner: The network with its data.
        schedule: Optimiser and length.
        card: Card of the weights; scores and curve are added.
        seed: Seed of what is drawn.
        out: The `.safetensors` file.
        state: File to go on from after a kill; None: none.
        on_step: Called with the number of steps done.

    Raises:
        TrainingDivergedError: If a loss is not finite; `out` has the last good weights.
        WeightsUnusableError: If `out` cannot be written.
    """

    def keep(done: Progress) -> None:
        facts: Mapping[str, str | int | float] = {
            **card.training,
            "curve": curve_text(done),
            "step": done.best_step,
        }
        save(out, done.kept, card.model_copy(update={"training": facts, "scores": done.scores}))

    done = run(
        learner,
        schedule,
        rng=np.random.default_rng(seed),
        state=state,
        keep=keep,
        on_step=on_step,
    )
    keep(done)
    return done
