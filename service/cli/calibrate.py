"""Verbs `calibrate`: fits the profile of a range image to logs of any lidar, or thresholds."""

from pathlib import Path
from typing import Annotated, Final

import typer

from service.cli.calibrate_motion import motion
from service.cli.options import MOST, Config, Force, Json, settings_for
from service.cli.output import json_line, progress, remark
from service.output_files import need_writable, save_text

_FEW_FRAMES: Final = 5
"""Number of frames below which means and deviations describe a single place."""


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    calibrate = typer.Typer(no_args_is_help=True, help="Calibrate a sensor, or the two-stage rule.")
    calibrate.command(
        epilog="counterpoint calibrate sensor logs/car-7/*/*.mcap --out roof-lidar.json"
    )(sensor)
    calibrate.command(
        epilog="counterpoint calibrate motion logs --truth truth --frames 0:28 --out rule.json"
    )(motion)
    app.add_typer(calibrate, name="calibrate")


def sensor(
    logs: Annotated[list[str], typer.Argument(help="URLs or paths of .mcap files of one sensor.")],
    out: Annotated[Path, typer.Option("--out", help="Profile to write: a .json or .toml file.")],
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the profile; default: the file's name.")
    ] = None,
    frames: Annotated[
        int, typer.Option("--frames", min=1, max=MOST, help="Frames per log at most.")
    ] = 20,
    every: Annotated[
        int, typer.Option("--every", min=1, max=MOST, help="Interval of the frames taken.")
    ] = 10,
    rows: Annotated[
        int | None,
        typer.Option(
            "--rows", min=1, max=MOST, help="Evenly spaced rows; default: one for each beam."
        ),
    ] = None,
    columns: Annotated[
        int | None,
        typer.Option("--columns", min=1, max=MOST, help="Columns; default: as measured."),
    ] = None,
    topic: Annotated[
        str | None, typer.Option("--topic", help="Lidar topic, where a log has several.")
    ] = None,
    json: Json = False,
    config: Config = None,
    force: Force = False,
) -> None:
    """Fit rows, field of view, beams, means and deviations of a range image to a lidar."""
    from service.cli.logs import locate
    from workers.lab.calibration.sensor_profile import (
        different_lidars,
        fit_profile,
        profile_text,
        sample_frames,
    )

    need_writable(out, option="--out", force=force, endings=(".json", ".toml"))
    settings = settings_for(config)
    mining = settings.mining()
    if topic:
        mining = mining.model_copy(update={"lidar_topic": topic})
    sampled = {}
    with progress() as bar:
        for log in bar.track(logs, description="reading"):
            store, recording = locate(log, root_url=settings.bucket)
            found = sample_frames(store, recording, mining, frames=frames, every=every)
            sampled[log] = found
            if every > 1 and len(found) < min(frames, _FEW_FRAMES):
                remark(f"{log}: frames taken: {len(found)}, one of {every}; --every 1 takes more")
    if mixed := different_lidars(sampled):
        remark(mixed)
    taken = [frame for found in sampled.values() for frame in found]
    fit = fit_profile(taken, name=name or out.stem, rows=rows, columns=columns)
    save_text(profile_text(fit.profile, out.suffix.lower()), out, option="--out", force=force)
    if json:
        json_line(fit)
        return
    profile = fit.profile
    for text in fit.remarks:
        remark(text)
    remark(
        f"{out}: {profile.rows} rows from {profile.fov_up_deg} to {profile.fov_down_deg} degrees, "
        f"{profile.columns} columns ({fit.steps_per_turn} steps a turn); of {fit.frames} frames "
        f"{fit.projected_share:.1%} of the points lie in the image, {fit.seen_share:.1%} are seen, "
        f"{fit.filled_share:.1%} of the pixels are filled"
    )
