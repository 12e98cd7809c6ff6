"""A simulated fleet: a bucket of logs of several vehicles and days, with truth beside it."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Final

from schemas.arrays import NS_PER_S
from workers.simulation.lidar import Lidar
from workers.simulation.recorded import Mistake, MistakeKind, plan_mistakes
from workers.simulation.worlds import EGO_STYLES, build_street
from workers.simulation.write import Identity, RecordedAs, write_log

MISTAKES_IN_TURN: Final[tuple[tuple[MistakeKind, ...], ...]] = (
    (MistakeKind.MISSED_MOVER,),
    (MistakeKind.PARKED_CALLED_MOVING,),
    (),
    (MistakeKind.MISSED_PEDESTRIAN, MistakeKind.MISSED_MOVER),
)
"""What the model on the car gets wrong in the first log, the second, and so on, in turn."""

_FIRST_DAY: Final = date(2026, 3, 2)
_VEHICLES: Final = 3
_SEED_STEP: Final = 1_000


@dataclass(frozen=True, slots=True)
class SimulatedLog:
    """One log of a simulated fleet.

    Attributes:
        log_id: Key of the log in its bucket, without extension.
        frames: Lidar frames in it.
        mistakes: What the model on the car gets wrong in it.
        log: The file.
        truth: The folder of its truth.
    """

    log_id: str
    frames: int
    mistakes: tuple[Mistake, ...]
    log: Path
    truth: Path


def simulate_fleet(
    out_folder: Path,
    *,
    logs: int,
    seconds: float,
    seed: int,
    mistakes: bool = True,
    lidar: Lidar | None = None,
    recorded: RecordedAs = "fields",
    chunk_bytes: int = 4 << 20,
    progress: Callable[[], None] | None = None,
) -> list[SimulatedLog]:
    """Write `out_folder/logs/<vehicle>/<date>/<name>.mcap` and the same under `truth`.

    The ego's style goes round, so that a fleet holds standing, driving and stopping cars, and so
    do the mistakes; every fourth log is free of them: a ranking that cannot put those last has
    proved nothing.

    Args:
        out_folder: Folder to write to; its `logs` is the bucket.
        logs: How many.
        seconds: How long each lasts.
        seed: Seed of the whole fleet.
        mistakes: Whether the model on the cars errs in the other logs.
        lidar: The lidar of every car; fewer columns make logs cheap.
        recorded: Where the labels of the model on the car go.
        chunk_bytes: Uncompressed size at which a chunk is closed.
        progress: Called after each frame.
    """
    lidar = lidar or Lidar()
    written = []
    for number in range(logs):
        street = build_street(
            seed * _SEED_STEP + number, seconds=seconds, style=EGO_STYLES[number % len(EGO_STYLES)]
        )
        kinds = MISTAKES_IN_TURN[number % len(MISTAKES_IN_TURN)]
        errs = mistakes and recorded != "nothing" and kinds
        planted = plan_mistakes(street, lidar=lidar, kinds=kinds) if errs else ()
        day = _FIRST_DAY + timedelta(days=number // _VEHICLES)
        vehicle = f"sim-{number % _VEHICLES + 1:02d}"
        key = f"{vehicle}/{day.isoformat()}/street-{number:03d}"
        start = datetime(day.year, day.month, day.day, 9, number % 60, tzinfo=UTC)
        log, truth = out_folder / "logs" / f"{key}.mcap", out_folder / "truth" / key
        frames = write_log(
            log,
            street,
            lidar=lidar,
            identity=Identity(
                vehicle=vehicle,
                date=day.isoformat(),
                software_version="2026.2" if number % 2 else "2026.1",
                start_ns=int(start.timestamp()) * NS_PER_S,
            ),
            recorded=recorded,
            mistakes=planted,
            truth=truth,
            log_key=f"logs/{key}.mcap",
            chunk_bytes=chunk_bytes,
            progress=progress,
        )
        written.append(SimulatedLog(key, frames, planted, log, truth))
    return written
