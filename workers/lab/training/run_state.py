"""State of a training run on disk: resumed after a kill, a run gives the same weights.

The state contains parameters, optimiser, schedule and random generators of one step. It is written
next to its target and renamed, so that a kill leaves the state before it. All that happens after a
step follows from the state of that step, so the interval of the writes changes no weight.
"""

import io
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from schemas.canonical import canonical_json
from workers.lab.training.errors import ResumeRefusedError, StateUnwritableError

REQUEST: Final = "request.json"
"""File of a work folder that names data and settings of its run."""

Curve = list[tuple[int, float, float]]
"""Step, mean loss since the entry before, and score on held-out data (NaN without any)."""


@dataclass(slots=True)
class Progress:
    """Progress of a run.

    Attributes:
        step: Steps done.
        curve: One entry for each scoring.
        losses: Sum and number of the losses since the last entry.
        best: Best score so far.
        best_step: Step of the best score.
        kept: Parameters of the best score, or of the last scoring without held-out data.
        scores: Scores of the kept parameters, by name.
    """

    step: int = 0
    curve: Curve = field(default_factory=list)
    losses: tuple[float, int] = (0.0, 0)
    best: float = float("-inf")
    best_step: int = 0
    kept: dict[str, Tensor] = field(default_factory=dict)
    scores: dict[str, float] = field(default_factory=dict)


def write_state(
    path: Path,
    progress: Progress,
    *,
    net: torch.nn.Module,
    optimiser: torch.optim.Optimizer,
    schedule: torch.optim.lr_scheduler.LRScheduler,
    rng: np.random.Generator,
) -> None:
    """Write the state of a run, whole or not at all.

    Raises:
        StateUnwritableError: If it cannot be written, for example because the disk is full.
    """
    packed = io.BytesIO()
    torch.save(
        {
            "progress": {name: getattr(progress, name) for name in Progress.__slots__},
            "net": net.state_dict(),
            "optimiser": optimiser.state_dict(),
            "schedule": schedule.state_dict(),
            "numpy": json.dumps(rng.bit_generator.state),
            "torch": torch.get_rng_state(),
            "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
        },
        packed,
    )
    write_whole(path, packed.getvalue())


def read_state(
    path: Path,
    *,
    net: torch.nn.Module,
    optimiser: torch.optim.Optimizer,
    schedule: torch.optim.lr_scheduler.LRScheduler,
    rng: np.random.Generator,
) -> Progress:
    """Restore a run where a state was written; a new one otherwise.

    Raises:
        ResumeRefusedError: If the state is damaged or of another network.
    """
    if not path.is_file():
        return Progress()
    try:
        # tensors, numbers and names only: a pickle with code is refused
        stored: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
        net.load_state_dict(stored["net"])
        optimiser.load_state_dict(stored["optimiser"])
        schedule.load_state_dict(stored["schedule"])
        rng.bit_generator.state = json.loads(stored["numpy"])
        torch.set_rng_state(stored["torch"])
        if stored["cuda"] and torch.cuda.is_available():
            torch.cuda.set_rng_state_all(stored["cuda"])
        return Progress(**stored["progress"])
    except Exception as error:  # what a damaged file raises is not documented
        raise ResumeRefusedError(
            f"the state of the unfinished training cannot be read: start again with --restart "
            f"({path})"
        ) from error


def open_request(folder: Path, request: Mapping[str, Any], *, restart: bool) -> bool:
    """Claim a work folder for a run, or find that its unfinished run is the same one.

    Args:
        folder: The work folder, made if need be.
        request: Data and settings that decide the weights, by name.
        restart: Give up an unfinished run of other data or settings.

    Returns:
        True if an unfinished run goes on.

    Raises:
        ResumeRefusedError: If the unfinished run has other data or settings, which it names.
        StateUnwritableError: If the folder cannot be written.
    """
    path = folder / REQUEST
    wanted = json.loads(canonical_json(dict(request)))
    if path.is_file() and not restart:
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            found = {}
        differing = sorted(
            name for name in {*wanted, *found} if wanted.get(name) != found.get(name)
        )
        if differing:
            raise ResumeRefusedError(
                f"the unfinished training there differs in {', '.join(differing)}: give it the "
                f"same again to go on, or --restart to begin from the start ({folder})"
            )
        return True
    clear(folder)
    write_whole(path, json.dumps(wanted, indent=1).encode())
    return False


def clear(folder: Path) -> None:
    """Remove a work folder that a run made; any other folder stays."""
    if (folder / REQUEST).is_file():
        shutil.rmtree(folder)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that a kill or a full disk leaves the one before.

    Raises:
        StateUnwritableError: If it cannot be written.
    """
    aside = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with aside.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        aside.replace(path)
    except OSError as error:
        aside.unlink(missing_ok=True)
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> StateUnwritableError:
    return StateUnwritableError(
        f"cannot write the state of the training: {error.strerror or error}; free space or name "
        f"another folder, then give the same command again to go on ({path})"
    )
