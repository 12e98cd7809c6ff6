"""Verb `bench overlay`: bytes and times of overlays, and scores computed again from them."""

import time
from typing import Annotated

import typer

from service.cli.options import Config, Json, settings_for
from service.cli.output import json_line, progress, remark, table


def overlay(
    url: Annotated[str, typer.Argument(help="URL or path of one .mcap file.")],
    processor: Annotated[
        bool, typer.Option("--processor", help="Measure processor time instead of wall time.")
    ] = False,
    json: Json = False,
    config: Config = None,
) -> None:
    """Compare overlays with version 1, and compute each score again from its overlay."""
    from service.cli.logs import locate
    from workers.lab.evaluation.benchmarks.bench_overlay import bench_overlays

    settings = settings_for(config)
    store, recording = locate(url, root_url=settings.bucket)
    rows = []
    with progress() as bar:
        task = bar.add_task("mining", total=None)
        clock = time.process_time if processor else time.perf_counter
        for row in bench_overlays(store, recording, settings.mining(), clock=clock):
            rows.append(row)
            bar.update(task, advance=1)
    if json:
        for row in rows:
            json_line(row)
        return
    table(
        f"{recording.log_id}: overlays beside version 1, one thread",
        (
            *("scene", "points a frame", "MB, version 1", "MB", "ratio", "largest view, kB"),
            *("write 1, ms", "write, ms", "read 1, ms", "read, ms", "block, ms", "pictures, kB"),
        ),
        (
            (
                row.scene.rpartition("/")[2],
                row.points,
                f"{row.version_1_bytes / 1e6:.2f}",
                f"{row.bytes / 1e6:.2f}",
                f"{row.ratio:.3f}",
                f"{row.view_bytes / 1e3:.0f}",
                *(f"{ms:.0f}" for ms in (row.encoding_1_ms, row.encoding_ms)),
                *(f"{ms:.0f}" for ms in (row.reading_1_ms, row.reading_ms)),
                f"{row.block_ms:.1f}",
                f"{row.picture_bytes / 1e3:.0f}",
            )
            for row in rows
        ),
    )
    same = sum(row.is_rescored for row in rows)
    before, after = (sum(getattr(r, n) for r in rows) for n in ("version_1_bytes", "bytes"))
    if rows:
        remark(f"all scenes: {after / before:.3f} times the bytes of version 1, without pictures")
    remark(f"{same} of {len(rows)} records computed again from their overlay, byte for byte")
