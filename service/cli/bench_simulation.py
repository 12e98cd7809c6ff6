"""Verb `bench simulation`: speed of the simulator and fidelity of its frames."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import MOST, Config, Force, Json, settings_for
from service.cli.output import json_line, progress, table
from service.output_files import need_writable, save_picture

if TYPE_CHECKING:
    from workers.lab.evaluation.benchmarks.bench_simulation import FrameStatistics


def simulation(
    url: Annotated[
        str | None, typer.Argument(help="URL or path of a real .mcap file to compare with.")
    ] = None,
    sensor: Annotated[
        str, typer.Option("--sensor", help="Simulated lidar: pandar64, hdl64, …")
    ] = "pandar64",
    frames: Annotated[
        int, typer.Option("--frames", min=1, max=MOST, help="Number of timed frames.")
    ] = 20,
    picture: Annotated[
        Path | None, typer.Option("--picture", help="PNG of a real frame next to simulated ones.")
    ] = None,
    json: Json = False,
    config: Config = None,
    force: Force = False,
) -> None:
    """Time the simulator on one core; with a log, compare simulated frames to its real ones."""
    from service.cli.logs import locate
    from workers.lab.evaluation.benchmarks.bench_simulation import bench_rates, simulated_statistics
    from workers.lab.evaluation.benchmarks.real_frames import real_statistics
    from workers.lab.simulation.sensor.sensors import SENSORS

    chosen = next((name for name in SENSORS if name == sensor), None)
    if chosen is None:
        raise typer.BadParameter(f"{sensor!r} is none of {', '.join(SENSORS)}")
    if picture is not None and url is None:
        raise typer.BadParameter("--picture needs a log to draw a frame of")
    if picture is not None:
        need_writable(picture, option="--picture", force=force, endings=(".png",))
    looks = []
    with progress() as bar:
        task = bar.add_task("timing", total=None)
        rates = bench_rates(
            frames=frames,
            on_progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
        if url is not None:
            settings = settings_for(config)
            store, recording = locate(url, root_url=settings.bucket)
            real, real_one = real_statistics(store, recording, settings.mining())
            simulated, others = simulated_statistics(chosen)
            looks = [real_one, *others]
            if picture is not None:
                from workers.lab.evaluation.benchmarks.comparison_picture import draw_side_by_side

                beside = draw_side_by_side([(real_one.name, real), *simulated[:2]])
                save_picture(beside, picture, option="--picture", force=force)
    if json:
        for rate in rates:
            json_line(asdict(rate))
        for look in looks:
            json_line(asdict(look))
        return
    table(
        "64 beams, 1800 columns: time of one core",
        ("step", "ms", "per second"),
        ((row.what, f"{row.ms:.0f}", f"{row.per_s:.1f}") for row in rates),
    )
    if looks:
        _say_looks(looks)


def _say_looks(looks: "Sequence[FrameStatistics]") -> None:
    from workers.lab.evaluation.benchmarks.bench_simulation import RANGES_M

    table(
        "share of points by range, percent",
        ("frames of", "points", *(f"-{far} m" for far in RANGES_M[1:])),
        (
            (look.name, round(look.points), *(f"{100 * share:.1f}" for share in look.range_share))
            for look in looks
        ),
    )
    table(
        "beams, dropouts and intensity",
        ("frames of", "points per beam over 1800, every 6th beam", "single gaps", "intensity"),
        (
            (
                look.name,
                " ".join(f"{share:.2f}" for share in look.ring_share[::6]),
                "" if look.single_gap_share is None else f"{100 * look.single_gap_share:.1f} %",
                " ".join(f"{value:.2f}" for value in look.intensity),
            )
            for look in looks
        ),
    )
