"""Simulated fleet: a bucket of logs of several vehicles and days, with their truth."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from multiprocessing import get_context
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory
from typing import Final
from urllib.parse import unquote, urlsplit

import numpy as np

from schemas.arrays import NS_PER_S
from schemas.transport.bucket import Bucket, open_bucket
from workers.lab.simulation.faults.disturbances import disturb, draw_disturbance
from workers.lab.simulation.faults.fault_placement import place_failures
from workers.lab.simulation.faults.fault_truth import PlantedFaults
from workers.lab.simulation.faults.plan import LogPlan
from workers.lab.simulation.output.write import Identity, RecordedAs, write_log
from workers.lab.simulation.sensor.lidar import Lidar, sweep
from workers.lab.simulation.sensor.sensors import (
    MountingName,
    SensorName,
    further_lidars,
    mounted,
)
from workers.lab.simulation.world.street import Street
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.street_plan import draw_plan

VEHICLES: Final[tuple[tuple[SensorName, MountingName], ...]] = (
    ("pandar64", "roof"),
    ("hdl64", "mast"),
    ("os1-128", "roof"),
    ("hdl32", "mast"),
    ("vlp32c", "roof"),
)
"""Sensor and mounting of each car of a fleet."""

_FIRST_DAY: Final = date(2026, 3, 2)


@dataclass(frozen=True, slots=True)
class SimulatedLog:
    """One log of a simulated fleet.

    Attributes:
        log_id: Key of the log in its bucket, without extension.
        frames: Lidar frames in it.
        planted: Faults planted in it.
        log: The file, in the folder it was written to first.
        truth: The folder of its truth, in the same place.
    """

    log_id: str
    frames: int
    planted: PlantedFaults
    log: Path
    truth: Path


@dataclass(frozen=True, slots=True)
class FleetOptions:
    """Output options of a fleet.

    Attributes:
        lidar: Lidar of every car; each its own (`VEHICLES`) when None.
        columns: Columns of every car's own lidar; fewer make logs cheap; the lidar's own when None.
        recorded: Destination of the on-board model's labels.
        chunk_bytes: Uncompressed size at which a chunk is closed.
        odometry: Whether the cars record wheel speed and yaw rate.
        fixes: Whether they record their place on Earth.
        slow_lorries: Whether lorries and buses pass each car at 2 to 4 m/s.
        lidars: Lidars of every car: its own, and near-field ones at the front, rear and sides.
    """

    lidar: Lidar | None = None
    columns: int | None = None
    recorded: RecordedAs = "fields"
    chunk_bytes: int = 4 << 20
    odometry: bool = False
    fixes: bool = False
    slow_lorries: bool = False
    lidars: int = 1


def on_days(plans: Sequence[LogPlan], days: int) -> tuple[LogPlan, ...]:
    """Plan each street on so many days, each day by the next car of the fleet.

    A street has the same traffic and the same failures each day, as a model fails at the same
    places again; lidar and receiver differ.
    """
    cars = len(VEHICLES)
    step = cars * -(-len(plans) // cars) + 1
    return tuple(
        replace(plan, number=plan.number + day * step, first_drive=plan.number)
        for day in range(days)
        for plan in plans
    )


def simulate_to(
    url: str,
    plans: Sequence[LogPlan],
    *,
    options: FleetOptions,
    processes: int = 1,
    progress: Callable[[], None] | None = None,
) -> Iterator[SimulatedLog]:
    """Write planned logs under `URL/logs` and their truth under `URL/truth`.

    The bytes are the same for any number of processes; the order of yielding is not.

    Args:
        url: A folder, or any writable bucket.
        plans: Plans of the logs.
        options: Output options.
        processes: Number of parallel processes.
        progress: Called after each frame; with several processes, as each log is done.

    Raises:
        BucketRefusedError: If the bucket is not writable.
        BucketUnreachableError: If the store does not answer.
    """
    open_bucket(url, create=True)
    if processes == 1:
        for plan in plans:
            yield _write_to(url, plan, options, progress)
        return
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(_write_to, url, plan, options) for plan in plans]
        for job in as_completed(jobs):
            log = job.result()
            for _ in range(log.frames if progress else 0):
                progress and progress()
            yield log


def _write_to(
    url: str,
    plan: LogPlan,
    options: FleetOptions,
    progress: Callable[[], None] | None = None,
) -> SimulatedLog:
    parts = urlsplit(url)
    if parts.scheme in ("", "file"):
        folder = Path(unquote(parts.path) if parts.scheme else url)
        return write_planned(folder, plan, options=options, progress=progress)
    with TemporaryDirectory(prefix="counterpoint-fleet-") as made:
        log = write_planned(Path(made), plan, options=options, progress=progress)
        _put_all(open_bucket(url), Path(made), log)
        return log


def _put_all(bucket: Bucket, folder: Path, log: SimulatedLog) -> None:
    """Copy the truth first, so that a watcher of the bucket finds it with the log."""
    for path in (*sorted(log.truth.iterdir()), log.log):
        bucket.put(path.relative_to(folder).as_posix(), path.read_bytes())


def write_planned(
    out_folder: Path,
    plan: LogPlan,
    *,
    options: FleetOptions | None = None,
    progress: Callable[[], None] | None = None,
) -> SimulatedLog:
    """Write one planned log of a fleet with its truth."""
    options = options or FleetOptions()
    car = plan.number % len(VEHICLES)
    lidar = options.lidar or mounted(*VEHICLES[car], columns=options.columns)
    street = planned_street(plan, slow_lorries=options.slow_lorries)
    first = car if plan.first_drive is None else plan.first_drive % len(VEHICLES)
    first_lidar = options.lidar or mounted(*VEHICLES[first], columns=options.columns)
    planted = draw_faults(street, plan, lidar=first_lidar)
    day = _FIRST_DAY + timedelta(days=plan.number // len(VEHICLES))
    vehicle = f"sim-{car + 1:02d}"
    key = f"{vehicle}/{day.isoformat()}/street-{plan.number:03d}"
    start = datetime(day.year, day.month, day.day, 9, plan.number % 60, tzinfo=UTC)
    log, truth = out_folder / "logs" / f"{key}.mcap", out_folder / "truth" / key
    rmtree(truth, ignore_errors=True)
    frames = write_log(
        log,
        street,
        lidar=lidar,
        further=further_lidars(lidar, options.lidars - 1),
        identity=Identity(
            vehicle=vehicle,
            date=day.isoformat(),
            software_version=plan.software_version,
            start_ns=int(start.timestamp()) * NS_PER_S,
        ),
        recorded=options.recorded,
        odometry=options.odometry,
        fixes=options.fixes,
        planted=planted,
        truth=truth,
        log_key=f"logs/{key}.mcap",
        chunk_bytes=options.chunk_bytes,
        progress=progress,
    )
    return SimulatedLog(key, frames, planted, log, truth)


def planned_street(plan: LogPlan, *, slow_lorries: bool = False) -> Street:
    """Build the street of a planned log; it depends on its arguments alone."""
    rng = np.random.default_rng([plan.seed, 0x91A4])
    drawn = draw_plan(rng, hard=plan.hard)
    drawn = replace(drawn, unsettling=plan.wants_common_mode, slow_lorries=slow_lorries)
    street = build_street(plan.seed, seconds=plan.seconds + plan.begin_s, plan=drawn)
    return street.after(plan.begin_s)


def draw_faults(street: Street, plan: LogPlan, *, lidar: Lidar) -> PlantedFaults:
    """Draw the faults of a log, once its street is known."""
    disturbances = tuple(draw_disturbance(each) for each in plan.disturbances)
    failures, redraws = place_failures(
        street,
        plan,
        frame_at=lambda index: disturb(sweep(street, lidar, index), disturbances),
        period_s=lidar.period_s,
    )
    return PlantedFaults(failures, disturbances, redraws, plan.hard, plan.lifelike)
