"""Verb `bench gpu`: what a GPU gains the supervised stream, and whether its labels change."""

from typing import Annotated

import typer

from service.cli.options import MOST, Config, Json, settings_for
from service.cli.output import json_line, progress, remark, table


def gpu(
    url: Annotated[str, typer.Argument(help="URL or path of one .mcap file.")],
    frames: Annotated[
        int, typer.Option("--frames", min=8, max=MOST, help="Number of frames, from the start.")
    ] = 16,
    seconds: Annotated[
        float, typer.Option("--seconds", min=0.1, help="Duration of each measurement.")
    ] = 5.0,
    json: Json = False,
    config: Config = None,
) -> None:
    """Time the networks and the supervised stream on a GPU, and compare labels with the CPU's."""
    from service.cli.logs import locate
    from workers.lab.evaluation.benchmarks.bench_gpu import bench_gpu

    settings = settings_for(config)
    with progress() as bar:
        task = bar.add_task("timing", total=None)
        store, recording = locate(url, root_url=settings.bucket)
        found = bench_gpu(
            store,
            recording,
            settings.mining(),
            frames=frames,
            seconds=seconds,
            on_progress=lambda what: bar.update(task, description=f"timing {what}"),
        )
    if json:
        json_line(found)
        return
    table(
        f"{found.log}: frames per second, {found.frames} frames of "
        f"{found.points // found.frames:,} points, one process",
        ("device", "frames at once", "both networks", "supervised stream", "GPU busy"),
        (
            (
                row.device,
                row.together,
                f"{row.networks_per_s:.1f}",
                f"{row.stream_per_s:.1f}",
                "" if row.busy is None else f"{100 * row.busy:.0f} %",
            )
            for row in found.speeds
        ),
    )
    remark(
        f"equal on both: {100 * found.same_labels:.3f} % of the motion labels, "
        f"{100 * found.same_classes:.3f} % of the classes"
    )
