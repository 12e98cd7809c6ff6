"""Verb `simulate`: a fleet of simulated logs with planted failures, and its truth."""

import time
from typing import Annotated, Any, Final

import typer

from schemas.transport.bucket import open_bucket
from service.cli.options import MOST, Json
from service.cli.output import counted, json_line, progress, remark
from service.errors import UsageError

SHORTEST_S: Final = 2.0
LONGEST_S: Final = 600.0
"""Bounds of `--log-seconds`."""


def add_to(app: typer.Typer) -> None:
    """Add the verb of this file to the command."""
    app.command(epilog="counterpoint simulate --scenes 100 --seed 1 --failures 0.05 --out fleet")(
        simulate
    )


def simulate(
    out: Annotated[str, typer.Option("--out", help="Folder or bucket URL for logs/ and truth/.")],
    scenes: Annotated[
        int,
        typer.Option("--scenes", min=1, max=MOST, help="Scenes of 2 s; by default ten make a log."),
    ] = 100,
    seed: Annotated[
        int, typer.Option("--seed", min=0, max=MOST, help="Seed; equal seeds give equal bytes.")
    ] = 1,
    failures: Annotated[
        float,
        typer.Option(
            "--failures", min=0.0, max=1.0, help="Share of scenes with a planted failure."
        ),
    ] = 0.05,
    columns: Annotated[
        int | None,
        typer.Option(
            "--columns",
            min=64,
            max=MOST,
            help="Firings per turn of every lidar; default: as the sensor has.",
        ),
    ] = None,
    odometry: Annotated[
        bool,
        typer.Option("--odometry", help="Record wheel speed and yaw rate of the cars too."),
    ] = False,
    fixes: Annotated[
        bool, typer.Option("--fixes", help="Record the places of the cars on Earth (NavSatFix).")
    ] = False,
    days: Annotated[
        int,
        typer.Option(
            "--days",
            min=1,
            max=365,
            help="Drive each street again, with the same traffic, by another car each day.",
        ),
    ] = 1,
    lifelike: Annotated[
        bool,
        typer.Option(
            "--lifelike",
            help="Labels with the noise of real models, ghosts that stick to structure, "
            "half-labelled lorries, logs that begin amid traffic.",
        ),
    ] = False,
    log_seconds: Annotated[
        str | None,
        typer.Option(
            "--log-seconds",
            metavar="LOW:HIGH",
            help="Shortest and longest log; default: 20:20, lifelike 4:16.",
        ),
    ] = None,
    boxes: Annotated[
        bool,
        typer.Option("--boxes", help="Record the boxes of a detector instead of labels of points."),
    ] = False,
    sensor: Annotated[
        str,
        typer.Option(
            "--sensor", help="Lidar of every car, such as hdl64-compensated; default: one each."
        ),
    ] = "",
    lidars: Annotated[
        int,
        typer.Option(
            "--lidars",
            min=1,
            max=5,
            help="Lidars of every car: its own, then near-field ones, front first.",
        ),
    ] = 1,
    slow_lorries: Annotated[
        bool,
        typer.Option("--slow-lorries", help="Let lorries and buses pass each car at 2 to 4 m/s."),
    ] = False,
    workers: Annotated[
        int, typer.Option("--workers", min=1, max=MOST, help="Number of processes.")
    ] = 1,
    json: Json = False,
    force: Annotated[
        bool, typer.Option("--force", help="Write next to logs that were not simulated.")
    ] = False,
) -> None:
    """Simulate a fleet's logs and their truth, with failures planted into the labels."""
    if not force:
        _need_no_other_logs(out)
    from workers.lab.simulation.faults.plan import plan_fleet
    from workers.lab.simulation.output.fleet import FleetOptions, on_days, simulate_to
    from workers.lab.simulation.sensor.sensors import SENSORS, mounted, usual_mounting

    chosen = next((name for name in SENSORS if name == sensor), None)
    if sensor and chosen is None:
        raise UsageError(f"--sensor: {sensor!r} is none of {', '.join(SENSORS)}")
    if lidars > 1 and (boxes or (chosen is not None and SENSORS[chosen].compensated)):
        raise UsageError(
            "--lidars: near-field lidars are simulated next to labels of points and raw clouds, "
            "not with --boxes or a compensated sensor"
        )
    lidar = None if chosen is None else mounted(chosen, usual_mounting(chosen), columns=columns)
    plans = plan_fleet(
        scenes=scenes,
        seed=seed,
        share=failures,
        lifelike=lifelike,
        log_s=None if log_seconds is None else _log_seconds(log_seconds),
    )
    plans, scenes = on_days(plans, days), scenes * days
    began_s, frames, planted, disturbed = time.monotonic(), 0, 0, 0
    with progress() as bar:
        task = bar.add_task("simulating", total=scenes * 20)
        logs = simulate_to(
            out,
            plans,
            options=FleetOptions(
                lidar=lidar,
                columns=columns,
                odometry=odometry,
                fixes=fixes,
                recorded="boxes" if boxes else "fields",
                slow_lorries=slow_lorries,
                lidars=lidars,
            ),
            processes=workers,
            progress=lambda: bar.advance(task),
        )
        for log in logs:
            frames += log.frames
            planted += len(log.planted.failures)
            disturbed += len(log.planted.disturbances)
            if json:
                row: dict[str, Any] = {
                    "log": log.log_id,
                    "frames": log.frames,
                    "failures": len(log.planted.failures),
                    "disturbances": len(log.planted.disturbances),
                    "hard": log.planted.hard,
                }
                json_line(row)
    took_s = time.monotonic() - began_s
    remark(
        f"{counted(len(plans), 'log')}, {counted(scenes, 'scene')}, {frames} frames, "
        f"{counted(planted, 'planted failure')}, {counted(disturbed, 'disturbance')} in {out}: "
        f"{frames / took_s / workers:.1f} frames a second and process"
    )


def _log_seconds(text: str) -> tuple[float, float]:
    """Read `LOW:HIGH`, the shortest and longest log.

    Raises:
        UsageError: If these are no two lengths of 2 s or more.
    """
    try:
        low, high = (float(each) for each in text.split(":"))
    except ValueError:
        low = high = 0.0
    if not SHORTEST_S <= low <= high <= LONGEST_S:
        raise UsageError(
            f"--log-seconds: {text!r} is no LOW:HIGH, the shortest and longest log of "
            f"{SHORTEST_S:.0f} to {LONGEST_S:.0f} seconds: --log-seconds 4:16"
        )
    return low, high


def _need_no_other_logs(url: str) -> None:
    """Refuse an output with logs but no truth, which is no simulated fleet.

    Raises:
        UsageError: If there is such a log.
    """
    bucket = open_bucket(url, create=True)
    first = next(bucket.list("logs"), None)
    if first is not None and next(bucket.list("truth"), None) is None:
        raise UsageError(
            f"--out: this place has logs that were not simulated, such as {first.key}: name "
            f"another, or write next to them with --force ({bucket.url})"
        )
