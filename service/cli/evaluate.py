"""Verbs `eval motion` and `eval semantics`: labels of streams against ground truth."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli import judges
from service.cli.options import MOST, BucketOfLogs, Config, Force, Json, Weights, settings_for
from service.cli.output import json_line, progress, remark, table
from service.cli.shards import shards
from service.cli.truth_options import Frames, Truth, parse_frames
from service.errors import UsageError
from service.output_files import need_folder, need_writable, save_picture

if TYPE_CHECKING:
    from workers.lab.evaluation.motion.table import LogEvaluation

WORST_FRAMES = 10


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    evaluation = typer.Typer(no_args_is_help=True, help="Evaluate streams against ground truth.")
    evaluation.command(epilog="counterpoint eval motion logs --truth truth --frames 10:56 --json")(
        motion
    )
    evaluation.command(epilog="counterpoint eval semantics logs --truth truth --frames 40:56")(
        semantics
    )
    evaluation.command(epilog="counterpoint eval shards logs --shard-seconds 2")(shards)
    judges.add_to(evaluation)
    app.add_typer(evaluation, name="eval")


def motion(
    bucket: BucketOfLogs,
    truth: Truth,
    frames: Frames = "0:",
    stream: Annotated[
        list[str] | None,
        typer.Option(
            "--stream",
            help="Stream to evaluate: selfsupervised (default), supervised, the name of a part, "
            "or dufomap. Repeatable, for a row each.",
        ),
    ] = None,
    alone: Annotated[
        bool, typer.Option("--alone", help="Run this stream without the other one.")
    ] = False,
    rows: Annotated[
        str, typer.Option("--rows", help="Beams to keep, a slice from the lowest up: 0::2.")
    ] = "",
    every: Annotated[
        int, typer.Option("--every", min=1, max=MOST, help="Interval of the frames kept.")
    ] = 1,
    yaw_noise_deg: Annotated[
        float,
        typer.Option(
            "--yaw-noise-deg", min=0.0, max=360.0, help="Random rotation of each pose, degrees."
        ),
    ] = 0.0,
    labels: Annotated[
        Path | None, typer.Option("--labels", help="Write labels and truth to DIR/x/y/NNNNNN.npz.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Draw the table into this PNG file.")
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option("--pictures", help="Draw the ten worst frames into this folder.")
    ] = None,
    json: Json = False,
    weights: Weights = None,
    config: Config = None,
    force: Force = False,
) -> None:
    """Evaluate motion labels per point, of one stream or of several side by side."""
    streams = tuple(dict.fromkeys(stream or ["selfsupervised"]))
    bounds, beams = parse_frames(frames), parse_rows(rows)
    settings = settings_for(config, bucket=bucket, weights=weights)
    if plot is not None:
        need_writable(plot, option="--plot", force=force, endings=(".png",))
    if pictures is not None:
        need_folder(pictures, option="--pictures")
    if labels is not None:
        need_folder(labels, option="--labels")
        if not force and any(labels.iterdir()):  # truth has files of the same names
            raise UsageError(
                f"--labels: this folder is not empty: name another, or write into it with --force "
                f"({labels})"
            )
    from service.pictures.evaluation_frames import draw_worst
    from service.pictures.table import draw_table
    from workers.lab.evaluation.motion.disturbance import Disturbance
    from workers.lab.evaluation.motion.motion import EvaluatedFrame, evaluate_motion
    from workers.lab.evaluation.motion.worst_frames import WorstFrames
    from workers.lab.evaluation.motion.written_labels import write_labels

    worst = {name: WorstFrames(WORST_FRAMES) for name in streams}

    def of_stream(folder: Path, name: str) -> Path:
        return folder if len(streams) == 1 else folder / name.replace(":", "-")

    def keep(judged: EvaluatedFrame) -> None:
        if labels is not None:
            write_labels(of_stream(labels, judged.stream), judged)
        if pictures is not None:
            worst[judged.stream].add(judged)

    with progress() as bar:
        task = bar.add_task("evaluating", total=None)
        evaluated = evaluate_motion(
            bucket,
            truth,
            frames=bounds,
            settings=settings.mining(),
            stream=streams,
            both=not alone,
            disturbance=Disturbance(beams, every, yaw_noise_deg),
            on_frame=keep,
            on_progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    if json:
        for row in evaluated:
            json_line(row)
    else:
        _say(evaluated, streams)
        for name in streams:
            if name in ("supervised", "selfsupervised"):
                remark(f"{name}: {getattr(settings, name)}")
    if plot is not None:
        save_picture(draw_table(evaluated), plot, option="--plot", force=force)
        remark(f"plot: {plot}")
    if pictures is not None:
        for name, frames_of_stream in worst.items():
            for path in draw_worst(of_stream(pictures, name), frames_of_stream.frames, force=force):
                remark(f"picture: {path}")


def semantics(
    bucket: BucketOfLogs,
    truth: Truth,
    frames: Frames = "0:",
    stream: Annotated[
        str, typer.Option("--stream", help="Stream to evaluate: supervised, or the name of a part.")
    ] = "supervised",
    json: Json = False,
    weights: Weights = None,
    config: Config = None,
) -> None:
    """Evaluate the supervised stream's classes per point, in eleven coarse classes."""
    first, last = parse_frames(frames)
    settings = settings_for(config, bucket=bucket, weights=weights)
    from workers.lab.evaluation.semantics.semantics import evaluate_semantics

    with progress() as bar:
        task = bar.add_task("evaluating", total=None)
        evaluated = evaluate_semantics(
            bucket,
            truth,
            frames=range(first, sys.maxsize if last is None else last),
            settings=settings.mining(),
            stream=stream,
            on_progress=lambda done: bar.update(task, completed=done),
        )
    if json:
        for row in evaluated:
            json_line(row)
        return
    classes = list(dict.fromkeys(name for row in evaluated for name in row.iou))
    judged = settings.supervised if stream == "supervised" else stream
    table(
        f"intersection over union of the classes, supervised stream {judged}",
        ("class", *(row.log for row in evaluated)),
        (
            ("mean of the classes", *(row.miou for row in evaluated)),
            ("all movable classes", *(row.movable_iou for row in evaluated)),
            *((name, *(row.iou.get(name) for row in evaluated)) for name in classes),
            ("share without a class", *(row.unanswered_share for row in evaluated)),
            ("frames", *(row.frames for row in evaluated)),
        ),
    )


def _say(evaluated: "list[LogEvaluation]", streams: tuple[str, ...]) -> None:
    """Print a summary table; the JSON lines contain everything."""
    several = len(streams) > 1

    def named(row: "LogEvaluation", *cells: object) -> tuple[object, ...]:
        return (row.log, row.stream, *cells) if several else (row.log, *cells)

    first = ("log", "stream") if several else ("log",)
    table(
        "dynamic points, side by side" if several else f"dynamic points, {streams[0]} stream",
        (*first, "frames", "IoU 25", "IoU 50", "IoU 80 m", "precision 80", "recall 80", "unknown"),
        (
            named(
                row,
                row.frames,
                *(row.iou[r] for r in ("25", "50", "80")),
                row.precision["80"],
                row.recall["80"],
                row.unknown_share["80"],
            )
            for row in evaluated
        ),
    )
    table(
        "moving objects of 20 or more points; false clusters of 25 or more points",
        (
            *(*first, "found 25", "found 50", "found 80 m", "false clusters per frame"),
            *("confirmed: IoU 80 m", "false clusters", "velocity error m/s", "ms per frame"),
        ),
        (
            named(
                row,
                *(row.object_recall[r] for r in ("25", "50", "80")),
                row.false_clusters_per_frame,
                row.confirmed_iou["80"],
                row.confirmed_false_clusters_per_frame,
                row.velocity_error_m_per_s["median"],
                row.ms_per_frame.get("total"),
            )
            for row in evaluated
        ),
    )
    table(
        "moving objects found under 80 m, all logs",
        (*first[1:], "by", "kind", "found", "tracks found"),
        (
            named(total, by, kind, share, _tracks(total, kind) if by == "class" else None)[1:]
            for total in evaluated[-len(streams) :]
            for by, shares in {
                "class": total.object_recall_by_class,
                "speed, m/s": total.object_recall_by_speed,
                "longest side, m": total.object_recall_by_size,
                "points": total.object_recall_by_points,
            }.items()
            for kind, share in shares.items()
        ),
    )


def _tracks(row: "LogEvaluation", kind: str) -> str:
    counted = row.objects_by_class[kind]
    return f"{counted.tracks_found} of {counted.tracks}"


def parse_rows(text: str) -> slice | None:
    """Parse a Python slice such as `0::2`; empty text keeps every beam.

    Raises:
        UsageError: If it is no slice.
    """
    if not text:
        return None
    try:
        bounds = [int(part) if part else None for part in text.split(":")]
        if not 2 <= len(bounds) <= 3:
            raise ValueError
        range(1)[slice(*bounds)]  # refuses a step of 0
    except ValueError:
        raise UsageError(f"--rows must be a slice, such as 0::2, got {text!r}") from None
    return slice(*bounds)
