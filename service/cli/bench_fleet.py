"""Verb `bench fleet`: the efficiency of many workers, and the memory of their service."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from service.cli.options import MOST, Json
from service.cli.output import json_line, progress, table
from service.errors import UsageError
from service.output_files import need_folder


def fleet(
    folder: Annotated[
        Path, typer.Option("--folder", help="Folder on the disk for the state.")
    ] = Path(),
    workers: Annotated[
        int, typer.Option("--workers", min=1, max=1024, help="Workers, each with a session.")
    ] = 64,
    mine_s: Annotated[
        float,
        typer.Option(
            "--mine-s",
            min=0.01,
            max=3600,
            help="Seconds in which a shard is mined; measure them with `bench pipeline`.",
        ),
    ] = 20.0,
    seconds: Annotated[
        float, typer.Option("--seconds", min=1, max=86_400, help="Measured time.")
    ] = 150.0,
    scenes_per_shard: Annotated[
        int, typer.Option("--scenes-per-shard", min=1, max=MOST, help="Records in one commit.")
    ] = 10,
    json: Json = False,
) -> None:
    """Run router, service and simulated workers; mining is replaced by a pause."""
    from service.bench_fleet import bench_fleet

    if not folder.is_dir():
        raise UsageError(f"--folder: no such folder: {folder}")
    need_folder(folder, option="--folder")
    with TemporaryDirectory(dir=folder, prefix="bench-fleet-") as state, progress() as bar:
        task = bar.add_task("starting", total=None)
        found = bench_fleet(
            Path(state),
            workers=workers,
            mine_s=mine_s,
            seconds=seconds,
            scenes_per_shard=scenes_per_shard,
            on_progress=lambda what: bar.update(task, description=what),
        )
    if json:
        json_line(found)
        return
    table(
        f"{found.workers} workers for {found.wall_s:g} s, {found.mine_s:g} s a shard",
        ("figure", "value"),
        (
            ("efficiency", found.efficiency),
            ("shards committed", found.shards),
            ("seconds until all mined", found.start_s),
            ("memory of the service at the start, MB", found.service_start_mb),
            ("memory of the service at the end, MB", found.service_end_mb),
            ("cores that the service took", found.service_cpu),
        ),
    )
