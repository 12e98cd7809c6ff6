"""A simulated fleet: a bucket of logs of several vehicles and days, with truth beside it."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Final

from schemas.arrays import NS_PER_S
from workers.simulation.disturbances import disturb, draw_disturbance
from workers.simulation.lidar import Lidar, sweep
from workers.simulation.plan import LogPlan, plan_fleet
from workers.simulation.planted_truth import Planted
from workers.simulation.planting import plant
from workers.simulation.street import Street
from workers.simulation.worlds import EGO_STYLES, build_street
from workers.simulation.write import Identity, RecordedAs, write_log

_FIRST_DAY: Final = date(2026, 3, 2)
_VEHICLES: Final = 3


@dataclass(frozen=True, slots=True)
class SimulatedLog:
    """One log of a simulated fleet.

    Attributes:
        log_id: Key of the log in its bucket, without extension.
        frames: Lidar frames in it.
        planted: What was put into it on purpose.
        log: The file.
        truth: The folder of its truth.
    """

    log_id: str
    frames: int
    planted: Planted
    log: Path
    truth: Path


def simulate_fleet(
    out_folder: Path,
    *,
    scenes: int,
    seed: int,
    share: float,
    lidar: Lidar | None = None,
    recorded: RecordedAs = "fields",
    chunk_bytes: int = 4 << 20,
    progress: Callable[[], None] | None = None,
) -> list[SimulatedLog]:
    """Write `out_folder/logs/<vehicle>/<date>/<name>.mcap` and the same under `truth`.

    The ego's style goes round, so that a fleet holds standing, driving and stopping cars.

    Args:
        out_folder: Folder to write to; its `logs` is the bucket.
        scenes: How many, ten to a log of 20 s.
        seed: Seed of the whole fleet.
        share: Of the scenes in which the model on the car errs.
        lidar: The lidar of every car; fewer columns make logs cheap.
        recorded: Where the labels of the model on the car go.
        chunk_bytes: Uncompressed size at which a chunk is closed.
        progress: Called after each frame.
    """
    lidar = lidar or Lidar()
    return [
        write_planned(
            out_folder,
            plan,
            lidar=lidar,
            recorded=recorded,
            chunk_bytes=chunk_bytes,
            progress=progress,
        )
        for plan in plan_fleet(scenes=scenes, seed=seed, share=share)
    ]


def write_planned(
    out_folder: Path,
    plan: LogPlan,
    *,
    lidar: Lidar,
    recorded: RecordedAs = "fields",
    chunk_bytes: int = 4 << 20,
    progress: Callable[[], None] | None = None,
) -> SimulatedLog:
    """Write one log of a fleet with its truth, as it was planned."""
    style = EGO_STYLES[plan.number % len(EGO_STYLES)]
    street = build_street(plan.seed, seconds=plan.seconds, style=style)
    planted = put_into(street, plan, lidar=lidar)
    day = _FIRST_DAY + timedelta(days=plan.number // _VEHICLES)
    vehicle = f"sim-{plan.number % _VEHICLES + 1:02d}"
    key = f"{vehicle}/{day.isoformat()}/street-{plan.number:03d}"
    start = datetime(day.year, day.month, day.day, 9, plan.number % 60, tzinfo=UTC)
    log, truth = out_folder / "logs" / f"{key}.mcap", out_folder / "truth" / key
    frames = write_log(
        log,
        street,
        lidar=lidar,
        identity=Identity(
            vehicle=vehicle,
            date=day.isoformat(),
            software_version=plan.software_version,
            start_ns=int(start.timestamp()) * NS_PER_S,
        ),
        recorded=recorded,
        planted=planted,
        truth=truth,
        log_key=f"logs/{key}.mcap",
        chunk_bytes=chunk_bytes,
        progress=progress,
    )
    return SimulatedLog(key, frames, planted, log, truth)


def put_into(street: Street, plan: LogPlan, *, lidar: Lidar) -> Planted:
    """Choose what is put into a log on purpose, now that its street is known."""
    disturbances = tuple(draw_disturbance(each) for each in plan.disturbances)
    failures, redraws = plant(
        street,
        plan,
        look=lambda index: disturb(sweep(street, lidar, index), disturbances),
        period_s=lidar.period_s,
    )
    return Planted(failures, disturbances, redraws, plan.hard)
