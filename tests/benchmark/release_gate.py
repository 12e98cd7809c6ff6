"""Fleets of two software versions, one with a regression of a class, to judge the release gate.

Both versions drive the same streets. The model of version B labels a share of the objects of one
class static. Each version is mined into its own state, by the product. Run it with

    python -m tests.benchmark.release_gate simulate FOLDER --columns 600
    counterpoint run --once --bucket FOLDER/a/logs --state FOLDER/state-a
    counterpoint run --once --bucket FOLDER/b/logs --state FOLDER/state-b
    counterpoint compare --a state=FOLDER/state-a --b state=FOLDER/state-b
    python -m tests.benchmark.release_gate split FOLDER/state-a    # equal versions: 20 comparisons
"""

import argparse
import sys
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Final

import numpy as np

from schemas.arrays import NS_PER_S
from service.api.state_reader import StateReader
from service.cli.output import result_line
from service.curation.compared_scenes import NamedSide
from service.curation.comparing import compare
from service.curation.comparison import ComparedSide, ComparisonTerms
from service.settings.config import read_settings
from workers.lab.simulation.faults.faults import PlantedFailure
from workers.lab.simulation.faults.plan import FailureKind, LogPlan, plan_fleet
from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.output.fleet import VEHICLES, draw_faults, planned_street
from workers.lab.simulation.output.write import Identity, write_log
from workers.lab.simulation.sensor.sensors import mounted
from workers.lab.simulation.world.street import Street

VERSION_A: Final = "2026.1"
VERSION_B: Final = "2026.2"

LOG_S: Final = 4.0
"""Length of a log, seconds: two scenes."""

FIRST_DAY: Final = date(2026, 3, 2)


def simulate(
    folder: Path,
    *,
    logs: int,
    regressed_logs: int,
    seed: int,
    regressed: StreetClass,
    share: float,
    columns: int,
) -> None:
    """Write the logs of version A to `FOLDER/a`, and those of version B to `FOLDER/b`.

    Args:
        folder: Where to write.
        logs: Logs of version A.
        regressed_logs: Logs of version B, on the first streets of version A.
        seed: Seed of the streets, of the failures of both versions, and of the regression.
        regressed: Class of the regression.
        share: Share of its objects that version B labels static.
        columns: Firings per turn of every lidar.
    """
    plans = plan_fleet(
        scenes=round(logs * LOG_S / 2), seed=seed, share=0.1, lifelike=True, log_s=(LOG_S, LOG_S)
    )
    for plan in plans:
        street = planned_street(plan)
        _write(folder / "a", plan, street, VERSION_A, (), columns)
        if plan.number < regressed_logs:
            planted = regression(street, plan, regressed=regressed, share=share)
            _write(folder / "b", plan, street, VERSION_B, planted, columns)


def regression(
    street: Street, plan: LogPlan, *, regressed: StreetClass, share: float
) -> tuple[PlantedFailure, ...]:
    """Return the failures of version B on a street: objects of a class, labelled static."""
    rng = np.random.default_rng([plan.seed, 0x6A7E])
    drawn = rng.random(len(street.actors))
    return tuple(
        PlantedFailure(
            FailureKind.VERSION_REGRESSION,
            track,
            0.0,
            plan.seconds,
            class_name=regressed.name.lower(),
        )
        for track, actor in enumerate(street.actors)
        if actor.street_class is regressed and not actor.parked and drawn[track] < share
    )


def _write(
    folder: Path,
    plan: LogPlan,
    street: Street,
    version: str,
    planted: tuple[PlantedFailure, ...],
    columns: int,
) -> None:
    car = plan.number % len(VEHICLES)
    day = FIRST_DAY + timedelta(days=plan.number // len(VEHICLES))
    key = f"sim-{car + 1:02d}/{day.isoformat()}/street-{plan.number:03d}"
    lidar = mounted(*VEHICLES[car], columns=columns)
    faults = draw_faults(street, plan, lidar=lidar)
    start = datetime(day.year, day.month, day.day, 9, plan.number % 60, tzinfo=UTC)
    write_log(
        folder / "logs" / f"{key}.mcap",
        street,
        lidar=lidar,
        identity=Identity(
            vehicle=f"sim-{car + 1:02d}",
            date=day.isoformat(),
            software_version=version,
            start_ns=int(start.timestamp()) * NS_PER_S,
        ),
        planted=replace(faults, failures=(*faults.failures, *planted)),
        truth=folder / "truth" / key,
        log_key=f"logs/{key}.mcap",
    )


def split(state: Path, *, splits: int, seed: int) -> int:
    """Compare halves of the logs of one version by road; print each, and return the alarms."""
    source = StateReader(read_settings(state=state).settings, now_s=0.0)
    scenes = source.compared_side(ComparedSide(), name=str(state)).scenes
    logs = sorted({scene.log_id for scene in scenes})
    rng, alarms = np.random.default_rng(seed), 0
    for number in range(splits):
        first = set(rng.permutation(logs)[: len(logs) // 2].tolist())
        found = compare(
            NamedSide("first half", [scene for scene in scenes if scene.log_id in first]),
            NamedSide("second half", [scene for scene in scenes if scene.log_id not in first]),
            ComparisonTerms(match="roads"),
        )
        alarms += found.regressed > 0
        least = min((row.corrected_p for row in found.groups), default=1.0)
        result_line(
            f"{number + 1}: {found.comparisons} comparisons, {found.regressed} regressed, "
            f"{found.improved} improved, least corrected p {least:.3f}"
        )
    result_line(f"{alarms} alarms in {splits} comparisons of equal versions, {len(logs)} logs")
    return alarms


def main() -> int:
    """Simulate the fleets, or compare halves of the logs of one version."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("simulate", "split"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--logs", type=int, default=80)
    parser.add_argument("--regressed-logs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=20261501)
    parser.add_argument("--class", dest="regressed", default="pedestrian")
    parser.add_argument("--share", type=float, default=0.5)
    parser.add_argument("--columns", type=int, default=600)
    parser.add_argument("--splits", type=int, default=20)
    asked = parser.parse_args()
    if asked.what == "split":
        split(asked.folder, splits=asked.splits, seed=asked.seed)
        return 0
    simulate(
        asked.folder,
        logs=asked.logs,
        regressed_logs=asked.regressed_logs,
        seed=asked.seed,
        regressed=StreetClass[asked.regressed.upper()],
        share=asked.share,
        columns=asked.columns,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
