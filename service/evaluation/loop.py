"""The loop: teach, mine, choose, label, teach on, judge; every result is kept and never redone."""

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Final, Self, TypeVar

from schemas.canonical import canonical_json
from schemas.mining import MiningSettings
from service.evaluation.loop_figure import LoopFigure, LoopPoint, figure_of
from service.evaluation.loop_orders import ORDERS, SceneKey, chosen_by
from service.evaluation.loop_steps import (
    Choice,
    LoopRun,
    LoopSettings,
    build_held_out,
    build_taught,
    judge_choice,
    label_scene,
    mine_fleet_log,
    teach_first,
)
from service.evaluation.mined_fleet import FleetScene, fleet_of
from workers.checkpoints.devices import device_of
from workers.lab.loop.mining import jobs_of_fleet
from workers.lab.loop.streets import UNKNOWN, write_fleet_log
from workers.version import version_of

_REVISION: Final = "2"
"""Increases when equal settings give other results."""


OnProgress = Callable[[str, int, int], None]
"""Called with what is done, the number done, and the number in all."""


def run_loop(
    fleet: Path,
    settings: LoopSettings,
    mining: MiningSettings,
    *,
    seeds: Sequence[int],
    kept: Path,
    processes: int = 1,
    on_progress: OnProgress = lambda what, done, total: None,
) -> LoopFigure:
    """Run the loop, or what of it is not yet in the folder of kept results.

    Args:
        fleet: Folder of the fleet; it is simulated there if it has no logs.
        settings: Size of the loop.
        mining: Mining settings; the supervised stream is the loop's own model.
        seeds: Seeds of the first model with its streets, of the batches and of the random choice.
        kept: Folder of the results.
        processes: Number of parallel processes; 1 runs in this one. Results do not depend on it.
        on_progress: Called with what is done, the number done, and the number in all.

    Raises:
        TruthUnusableError: If no log of the fleet has truth.
        LogUnusableError: If a log cannot be mined.
    """
    with Pool(processes, on_progress) as pool:
        if not (fleet / "logs").is_dir() or (fleet / _SIMULATED).is_file():
            (fleet / _SIMULATED).touch()
            simulated = partial(write_fleet_log, fleet, seed=settings.fleet_seed)
            pool.run("logs of the fleet", simulated, range(settings.logs))
        run = LoopRun(fleet, kept / _digest(fleet, settings, mining), settings, mining)
        pool.run("held-out streets", partial(build_held_out, run), range(settings.held_out))
        streets = [(seed, number) for seed in seeds for number in range(settings.taught)]
        pool.run("taught streets", partial(build_taught, run), streets)
        pool.run("first models", partial(teach_first, run), seeds)
        jobs = [(seed, number) for seed in seeds for number in range(len(jobs_of_fleet(fleet)))]
        mined = pool.run("logs mined", partial(mine_fleet_log, run), jobs)
        choices: list[tuple[str, int, int, Choice]] = [("", 0, seed, ()) for seed in seeds]
        fleets = {}
        for seed in seeds:
            logs = [log for (of, _), log in zip(jobs, mined, strict=True) if of == seed]
            fleets[seed] = fleet_of([each.log for each in logs])
            entropy = {name: value for each in logs for name, value in each.entropy.items()}
            choose = partial(chosen_by, fleet=fleets[seed], entropy=entropy, seed=seed)
            choices += [
                (order, budget, seed, tuple(choose(order, budget=budget)))
                for order in ORDERS
                for budget in settings.budgets
            ]
        wanted = sorted({key for *_, chosen in choices for key in chosen})
        pool.run("scenes labelled", partial(label_scene, run), wanted)
        sets = sorted({(seed, tuple(sorted(chosen))) for *_, seed, chosen in choices})
        judged = dict(zip(sets, pool.run("models", partial(judge_choice, run), sets), strict=True))
    points = [
        LoopPoint(
            order=order,
            budget=budget,
            seed=seed,
            scenes=len(chosen),
            with_unknown=_with_unknown(fleets[seed], chosen),
            streets=tuple(judged[seed, tuple(sorted(chosen))]),
        )
        for order, budget, seed, chosen in choices
    ]
    return figure_of(points, fleet_scenes=len(fleets[seeds[0]]))


_SIMULATED: Final = "simulated-for-the-loop"
"""File in the folder of a fleet that the loop simulated, and may go on with after a kill."""

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


class Pool:
    """Runs the tasks of each step of the loop, in this process or in several.

    Args:
        processes: Number of processes.
        on_progress: Called with the step, the number of its tasks done, and the number in all.
    """

    def __init__(self, processes: int, on_progress: OnProgress) -> None:
        self._on_progress = on_progress
        self._pool = (
            ProcessPoolExecutor(processes, mp_context=get_context("spawn"))
            if processes > 1
            else None
        )

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the processes; tasks that have not begun are given up."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def run(
        self, what: str, act: Callable[[_Task], _Result], tasks: Sequence[_Task]
    ) -> list[_Result]:
        """Run a step and return the result of each task, in their order."""
        self._on_progress(what, 0, len(tasks))
        results = map(act, tasks) if self._pool is None else self._pool.map(act, tasks)
        found = []
        for done, result in enumerate(results, start=1):
            found.append(result)
            self._on_progress(what, done, len(tasks))
        return found


def _with_unknown(fleet: Sequence[FleetScene], chosen: Sequence[SceneKey]) -> int:
    """Count the chosen scenes in which something of an unknown class moves."""
    names = {each.name.lower() for each in UNKNOWN}
    keys = set(chosen)
    return sum(
        SceneKey(each.candidate.scene.log_id, each.row.cell) in keys
        and any(thing.moves and thing.class_name in names for thing in each.row.things)
        for each in fleet
    )


def _digest(fleet: Path, settings: LoopSettings, mining: MiningSettings) -> str:
    """Name the results of one fleet, size and pipeline: others lie in another folder."""
    facts = {
        "revision": _REVISION,
        "fleet": {job.recording.log_id: job.recording.revision for job in jobs_of_fleet(fleet)},
        "size": {**asdict(settings), "budgets": 0, "logs": 0},
        "device": device_of(mining.device),
        "pipeline": version_of(mining.model_copy(update={"supervised": "recorded", "model": ""})),
    }
    return hashlib.sha256(canonical_json(facts)).hexdigest()[:12]
