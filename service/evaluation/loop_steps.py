"""Steps of the loop over kept results; each task runs in a process of its own, and only once."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from typing import Final

from pydantic import TypeAdapter, ValidationError

from schemas.mining import MiningSettings
from service.evaluation.loop_orders import SceneKey
from workers.checkpoints.devices import device_of
from workers.lab.datasets.learnt_images import LearntImages
from workers.lab.loop.mining import (
    MinedByModel,
    jobs_of_fleet,
    mine_with,
    scene_labels,
)
from workers.lab.loop.model import (
    StreetCount,
    held_out_street,
    judge,
    load_model,
    taught_street,
    teach,
)


@dataclass(frozen=True, slots=True)
class LoopSettings:
    """Size of the loop.

    Attributes:
        logs: Logs of a fleet that is simulated, two scenes each.
        taught: Streets of the first model.
        held_out: Streets that judge.
        steps: Steps of the first model.
        more_steps: Steps with the chosen scenes, the same for every choice.
        budgets: Numbers of labelled scenes, rising.
        fleet_seed: Seed of the fleet and of the held-out streets.
    """

    logs: int = 30
    taught: int = 24
    held_out: int = 24
    steps: int = 4000
    more_steps: int = 500
    budgets: tuple[int, ...] = (1, 2, 4, 8, 16)
    fleet_seed: int = 1


@dataclass(frozen=True, slots=True)
class LoopRun:
    """A run, as each process of it gets it.

    Attributes:
        fleet: Folder of the fleet.
        kept: Folder of the results of this fleet, size and pipeline.
        settings: Size of the loop.
        mining: Mining settings; the supervised stream is the loop's own model.
    """

    fleet: Path
    kept: Path
    settings: LoopSettings
    mining: MiningSettings

    def of_seed(self, seed: int) -> Path:
        """Return the folder of a seed."""
        return self.kept / f"seed-{seed}"


Choice = tuple[SceneKey, ...]


_COUNTS: Final = TypeAdapter(list[StreetCount])


def build_held_out(run: LoopRun, number: int) -> None:
    """Build the images of a held-out street."""
    held_out_street(run.kept / "held-out", number, seed=run.settings.fleet_seed)


def build_taught(run: LoopRun, task: tuple[int, int]) -> None:
    """Build the images of a street of the first model; a task is its seed and number."""
    seed, number = task
    taught_street(run.of_seed(seed) / "taught", number, seed=seed)


def teach_first(run: LoopRun, seed: int) -> None:
    """Teach the first model of a seed."""
    folder = run.of_seed(seed)
    teach(
        _streets(run, seed),
        [],
        steps=run.settings.steps,
        seed=seed,
        out=folder / "first",
        device=device_of(run.mining.device),
    )


def mine_fleet_log(run: LoopRun, task: tuple[int, int]) -> MinedByModel:
    """Mine a log with the first model of a seed; a task is the seed and the number of the log."""
    seed, number = task
    folder = run.of_seed(seed)
    job = jobs_of_fleet(run.fleet)[number]
    return mine_with(
        run.fleet, job, load_model(folder / "first"), run.mining, kept=folder / "mined"
    )


def label_scene(run: LoopRun, key: SceneKey) -> None:
    """Build the images of a labelled scene."""
    scene_labels(run.fleet, key.log_id, key.cell, run.mining, kept=run.kept / "labels")


def judge_choice(run: LoopRun, task: tuple[int, Choice]) -> list[StreetCount]:
    """Teach a model on with chosen scenes and judge it, unless this set was judged before."""
    seed, chosen = task
    folder = run.of_seed(seed)
    names = "\n".join(f"{each.log_id} {each.cell}" for each in chosen)
    name = f"point-{len(chosen):03d}-{hashlib.sha256(names.encode()).hexdigest()[:16]}"
    file = folder / f"{name}.json"
    if file.is_file():
        try:
            return _COUNTS.validate_json(file.read_bytes())
        except ValidationError:  # of an earlier form: it is made again
            file.unlink()
    labels = run.kept / "labels"
    images = [
        image
        for each in chosen
        for image in scene_labels(run.fleet, each.log_id, each.cell, run.mining, kept=labels)
    ]
    rmtree(folder / name, ignore_errors=True)
    model = teach(
        _streets(run, seed),
        images,
        steps=run.settings.more_steps,
        seed=seed,
        out=folder / name,
        initial=load_model(folder / "first"),
        device=device_of(run.mining.device),
    )
    held_out = [
        held_out_street(run.kept / "held-out", number, seed=run.settings.fleet_seed)
        for number in range(run.settings.held_out)
    ]
    streets = judge(model, held_out)
    growing = file.with_suffix(".part")
    growing.write_bytes(_COUNTS.dump_json(streets))
    growing.replace(file)
    rmtree(folder / name)
    return streets


def _streets(run: LoopRun, seed: int) -> list[LearntImages]:
    folder = run.of_seed(seed) / "taught"
    return [
        each
        for number in range(run.settings.taught)
        for each in taught_street(folder, number, seed=seed)
    ]
