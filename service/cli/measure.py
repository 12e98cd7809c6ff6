"""Verb `bench`: time of a part or of the whole, compared with baselines of the same run."""

import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from service.cli.bench_fleet import fleet
from service.cli.bench_gpu import gpu
from service.cli.bench_loop import loop
from service.cli.bench_overlay import overlay
from service.cli.bench_selection import selection
from service.cli.bench_simulation import simulation
from service.cli.bench_viewer import viewer
from service.cli.failures import failures
from service.cli.options import MOST, Config, Json, settings_for
from service.cli.output import json_line, progress, remark, table
from service.cli.report import said_of
from service.errors import UsageError
from service.output_files import need_folder


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    bench = typer.Typer(no_args_is_help=True, help="Benchmark, with baselines of the same run.")
    bench.command(epilog="counterpoint bench pipeline logs/car-7/2026-11-20/drive.mcap")(pipeline)
    bench.command(epilog="counterpoint bench motion logs/car-7/2026-11-20/drive.mcap")(motion)
    bench.command(epilog="counterpoint bench networks logs/car-7/2026-11-20/drive.mcap")(networks)
    bench.command(epilog="counterpoint bench gpu logs/car-7/2026-11-20/drive.mcap")(gpu)
    bench.command(epilog="counterpoint bench ledger --folder /var/lib/counterpoint")(ledger)
    bench.command(epilog="counterpoint bench fleet --workers 64 --mine-s 20")(fleet)
    bench.command(epilog="counterpoint bench listing --scenes 1000000")(listing)
    bench.command(epilog="counterpoint bench failures fleet --report failures.html")(failures)
    bench.command(epilog="counterpoint bench simulation drive.mcap --sensor pandar64")(simulation)
    bench.command(epilog="counterpoint bench overlay logs/car-7/2026-11-20/drive.mcap")(overlay)
    bench.command(epilog="counterpoint bench viewer --state counterpoint-state")(viewer)
    bench.command(epilog="counterpoint bench selection counterpoint-state/bench")(selection)
    bench.command(epilog="counterpoint bench loop fleet --plot loop.png")(loop)
    app.add_typer(bench, name="bench")


def pipeline(
    url: Annotated[
        str | None, typer.Argument(help="URL or path of one .mcap file; none: a simulated street.")
    ] = None,
    frames: Annotated[
        int, typer.Option("--frames", min=1, max=MOST, help="Number of timed frames.")
    ] = 30,
    json: Json = False,
    config: Config = None,
) -> None:
    """Profile the stages of `score`, and time its parts alone."""
    from service.cli.logs import locate
    from workers.lab.evaluation.benchmarks.bench import bench_pipeline

    settings = settings_for(config)
    with TemporaryDirectory() as folder, progress() as bar:
        task = bar.add_task("timing", total=None)
        log = url or _simulated(Path(folder), frames=frames)
        store, recording = locate(log, root_url=settings.bucket)
        rows = bench_pipeline(
            store,
            recording,
            settings.mining(),
            frames=frames,
            on_progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    if json:
        for row in rows:
            json_line(row)
        return
    table(
        f"{recording.log_id}: milliseconds per frame, one thread",
        ("part", "mean", "median", "95th percentile", "share of score"),
        (
            (row.part, *(f"{ms:.1f}" for ms in (row.mean_ms, row.median_ms, row.p95_ms)), row.share)
            for row in rows
        ),
    )
    remark(f"streams: {said_of(settings.supervised, settings.selfsupervised)}")


def motion(
    url: Annotated[str, typer.Argument(help="URL or path of one .mcap file.")],
    frames: Annotated[
        str,
        typer.Option(
            "--frames", help="Number of frames after ten warm-up frames, or A:B, half open."
        ),
    ] = "10:",
    processor: Annotated[
        bool, typer.Option("--processor", help="Measure processor time instead of wall time.")
    ] = False,
    json: Json = False,
    config: Config = None,
) -> None:
    """Profile the self-supervised stream, and time KISS-ICP and Patchwork++ for comparison."""
    from service.cli.logs import locate
    from service.cli.truth_options import parse_frames
    from workers.lab.evaluation.benchmarks.bench_motion import bench_motion

    bounds = (10, 10 + int(frames)) if frames.isdecimal() else parse_frames(frames)
    settings = settings_for(config)
    with progress() as bar:
        task = bar.add_task("timing", total=None)
        store, recording = locate(url, root_url=settings.bucket)
        timed = bench_motion(
            store,
            recording,
            settings.mining(),
            frames=bounds,
            clock=time.process_time if processor else time.perf_counter,
            on_progress=lambda done: bar.update(task, completed=done),
        )
    if json:
        json_line(timed)
        return
    table(
        f"{timed.log}: milliseconds per frame of {timed.points} points, one thread",
        ("part", "median", "mean", "95th percentile"),
        (
            (row.part, *(f"{ms:.1f}" for ms in (row.median_ms, row.mean_ms, row.p95_ms)))
            for row in timed.parts
        ),
    )
    remark(
        f"the stream takes {timed.ratio:.2f} times as long as KISS-ICP and Patchwork++ together, "
        f"{timed.ratio_with_odometry:.2f} with odometry; at most {timed.memory_mib:.0f} MiB "
        "beyond the interpreter"
    )


def networks(
    url: Annotated[
        str | None, typer.Argument(help="URL or path of one .mcap file; none: a simulated street.")
    ] = None,
    frames: Annotated[
        int,
        typer.Option(
            "--frames", min=1, max=MOST, help="Number of timed frames, after ten warm-up frames."
        ),
    ] = 5,
    rounds: Annotated[
        int, typer.Option("--rounds", min=1, max=MOST, help="Runs of each network.")
    ] = 3,
    only: Annotated[
        str | None,
        typer.Option("--only", help="Networks to time: images (SalsaNext, LMNet) or flowstep3d."),
    ] = None,
    points: Annotated[
        list[int] | None,
        typer.Option(
            "--points", min=64, max=MOST, help="Points of FlowStep3D's clouds. Repeatable."
        ),
    ] = None,
    processor: Annotated[
        bool, typer.Option("--processor", help="Measure processor time instead of wall time.")
    ] = False,
    json: Json = False,
    config: Config = None,
) -> None:
    """Time the networks and, for comparison, a plain transcription of their forward passes."""
    from service.cli.logs import locate
    from workers.lab.evaluation.benchmarks.bench_flow import FLOW_POINTS, bench_flow
    from workers.lab.evaluation.benchmarks.bench_networks import bench_images
    from workers.lab.evaluation.benchmarks.network_time import NetworkTime

    if only not in (None, "images", "flowstep3d"):
        raise typer.BadParameter(f"{only!r} is neither images nor flowstep3d")
    settings = settings_for(config)
    clock = time.process_time if processor else time.perf_counter
    rows: list[NetworkTime] = []
    with TemporaryDirectory() as folder, progress() as bar:
        task = bar.add_task("timing", total=None)
        if only != "flowstep3d":
            log = url or _simulated(Path(folder), frames=10 + frames)
            store, recording = locate(log, root_url=settings.bucket)
            rows += bench_images(
                store,
                recording,
                settings.mining(),
                frames=frames,
                rounds=rounds,
                clock=clock,
                on_progress=lambda what: bar.update(task, description=f"timing {what}"),
            )
        for size in (points or FLOW_POINTS) if only != "images" else ():
            bar.update(task, description=f"timing flowstep3d, {size} points")
            rows += bench_flow(size, rounds=rounds, clock=clock)
    if json:
        for row in rows:
            json_line(row)
        return
    table(
        "networks, one thread, in pairs with the published forward pass (plain)",
        ("network", "variant", "size", "median ms", "speed-up", "changed", "memory MiB"),
        (
            (
                row.network,
                row.way,
                row.size,
                f"{row.median_ms:.1f}",
                f"{row.faster:.2f}",
                "" if row.changed is None else f"{row.changed:.3g}",
                "" if row.memory_mib is None else f"{row.memory_mib:.0f}",
            )
            for row in rows
        ),
    )


def ledger(
    folder: Annotated[
        Path, typer.Option("--folder", help="Folder on the disk for the state.")
    ] = Path(),
    scenes_per_shard: Annotated[
        int, typer.Option("--scenes-per-shard", min=1, max=MOST, help="Records in one commit.")
    ] = 10,
    shards: Annotated[
        int, typer.Option("--shards", min=100, max=MOST, help="Timed shards per row.")
    ] = 1000,
    filled: Annotated[
        int,
        typer.Option(
            "--filled",
            min=0,
            max=MOST,
            help="Scenes in the ledger for a second run; 0: no second run.",
        ),
    ] = 100_000,
    json: Json = False,
) -> None:
    """Count durable commits per second, next to the limits of the disk and of SQLite alone."""
    from service.store.bench_ledger import bench_ledger

    if not folder.is_dir():
        raise UsageError(f"--folder: no such folder: {folder}")
    need_folder(folder, option="--folder")
    with TemporaryDirectory(dir=folder, prefix="bench-ledger-") as state, progress() as bar:
        task = bar.add_task("timing", total=None)
        rows = bench_ledger(
            Path(state),
            scenes_per_shard=scenes_per_shard,
            shards=shards,
            filled=filled,
            on_progress=lambda what: bar.update(task, description=f"timing {what}"),
        )
    if json:
        for row in rows:
            json_line(row)
        return
    table(
        f"durable writes, {scenes_per_shard} scenes per shard",
        ("write", "threads", "scenes in the ledger", "per second", "median ms", "99th ms"),
        ((r.what, r.threads, r.scenes, r.per_s, r.median_ms, r.p99_ms) for r in rows),
    )


def listing(
    folder: Annotated[
        Path | None,
        typer.Option(
            "--folder",
            help="Folder for the state; it is kept, and used again; default: one that is deleted.",
        ),
    ] = None,
    scenes: Annotated[
        int, typer.Option("--scenes", min=1, max=MOST, help="Scenes in the ledger.")
    ] = 100_000,
    json: Json = False,
) -> None:
    """Time pages of the listing by filter, order and search, in a large ledger."""
    from service.store.bench_listing import bench_listing

    if folder is not None:
        need_folder(folder, option="--folder")
        folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix="bench-listing-") as temporary, progress() as bar:
        task = bar.add_task("timing", total=None)
        rows = bench_listing(
            folder or Path(temporary),
            scenes=scenes,
            on_progress=lambda what: bar.update(task, description=what),
        )
    if json:
        for row in rows:
            json_line(row)
        return
    table(
        f"pages of a ledger of {rows[0].scenes} scenes",
        ("request", "scenes that pass", "median ms", "most ms", "ms of one core"),
        ((row.what, row.total, row.median_ms, row.most_ms, row.core_ms) for row in rows),
    )


def _simulated(folder: Path, *, frames: int) -> str:
    """Simulate a street log that is long enough, for a call without a log."""
    from workers.lab.evaluation.benchmarks.bench import WARMING_FRAMES
    from workers.lab.simulation.output.write import write_log
    from workers.lab.simulation.world.street_builder import build_street

    log = folder / "sim-01" / "2026-03-02" / "street.mcap"
    seconds = (frames + WARMING_FRAMES) / 10 + 4.0
    write_log(log, build_street(1, seconds=seconds), recorded="nothing")
    return str(log)
