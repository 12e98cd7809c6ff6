"""Verbs `eval flow`, `eval ground` and `eval odometry`: each against truth, floors in its table."""

import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from service.cli.options import BucketOfLogs, Config, Json, Weights, settings_for
from service.cli.output import json_line, progress, remark, table
from service.cli.truth_options import Frames, Truth, parse_frames

if TYPE_CHECKING:
    from workers.lab.evaluation.figures import Interval
    from workers.lab.evaluation.flow.flow import FlowEvaluation
    from workers.lab.evaluation.ground.ground import GroundEvaluation
    from workers.lab.evaluation.odometry.odometry import OdometryEvaluation

    _Row = TypeVar("_Row", FlowEvaluation, GroundEvaluation, OdometryEvaluation)


def add_to(evaluation: typer.Typer) -> None:
    """Add the verbs of this file to `eval`."""
    evaluation.command(epilog="counterpoint eval flow logs --truth truth --json")(flow)
    evaluation.command(epilog="counterpoint eval ground logs --truth truth --method ground")(ground)
    evaluation.command(epilog="counterpoint eval odometry logs --truth truth")(odometry)


def flow(
    bucket: BucketOfLogs,
    truth: Truth,
    frames: Frames = "0:",
    flow: Annotated[
        list[str] | None,
        typer.Option(
            "--flow",
            help="Flow next to the floors: flowstep3d. Repeatable; default: of --weights.",
        ),
    ] = None,
    json: Json = False,
    weights: Weights = None,
    config: Config = None,
) -> None:
    """Evaluate scene flows: end-point errors off the ground, static and dynamic points."""
    settings = settings_for(config, bucket=bucket, weights=weights)
    from workers.lab.evaluation.flow.flow import KINDS, evaluate_flow

    with progress() as bar:
        task = bar.add_task("evaluating", total=None)
        rows, without = evaluate_flow(
            bucket,
            truth,
            frames=_range(frames),
            settings=settings.mining(),
            flows=flow or (),
            on_progress=lambda done: bar.update(task, completed=done),
        )
    _name_logs(without, "true flow")
    if json:
        for row in rows:
            json_line(row)
        return
    table(
        "scene flow, points off the ground within 80 m: mean end-point error (EPE), metres",
        (
            *("log", "flow", "frames", *(f"EPE {kind}" for kind in KINDS), "95 % of logs"),
            *("strict", "relaxed", "strict dynamic", "relaxed dynamic"),
        ),
        (
            (
                *(row.log, row.flow, row.frames, *(row.epe_m[kind] for kind in KINDS)),
                _interval(row.intervals["all"]),
                *(row.strict["all"], row.relaxed["all"]),
                *(row.strict["dynamic"], row.relaxed["dynamic"]),
            )
            for row in _shown(rows)
        ),
    )


def ground(
    bucket: BucketOfLogs,
    truth: Truth,
    frames: Frames = "0:",
    method: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            help="Method next to the floors: ground, salsanext:ground (both by default), "
            "recorded:ground, gndnet. Repeatable.",
        ),
    ] = None,
    json: Json = False,
    weights: Weights = None,
    config: Config = None,
) -> None:
    """Evaluate the ground: its points, and the error of its height in cells of a metre."""
    settings = settings_for(config, bucket=bucket, weights=weights)
    from workers.lab.evaluation.ground.ground import DEFAULT, evaluate_ground

    with progress() as bar:
        task = bar.add_task("evaluating", total=None)
        rows, without = evaluate_ground(
            bucket,
            truth,
            frames=_range(frames),
            settings=settings.mining(),
            methods=method or DEFAULT,
            on_progress=lambda done: bar.update(task, completed=done),
        )
    _name_logs(without, "true ground")
    if json:
        for row in rows:
            json_line(row)
        return
    table(
        "ground points between 2.5 and 80 m; error of the height of the ground, metres",
        (
            *("log", "method", "frames", "precision", "recall", "IoU"),
            *("right, 95 % of logs", "height median", "height 90 %", "cells without"),
        ),
        (
            (
                *(row.log, row.method, row.frames, row.precision, row.recall, row.iou),
                _interval(row.interval),
                *(row.height_error_m.get("median"), row.height_error_m.get("q90")),
                row.cells_without_height,
            )
            for row in _shown(rows)
        ),
    )


def odometry(
    bucket: BucketOfLogs,
    truth: Truth,
    frames: Frames = "0:",
    odometry: Annotated[
        list[str] | None,
        typer.Option(
            "--odometry",
            help="Odometry next to that of the settings and the floors. Repeatable; default: that "
            "of --weights, delora.",
        ),
    ] = None,
    json: Json = False,
    weights: Weights = None,
    config: Config = None,
) -> None:
    """Evaluate odometries: relative pose errors per frame, and over segments of 100 to 800 m."""
    settings = settings_for(config, bucket=bucket, weights=weights)
    from workers.lab.evaluation.odometry.odometry import evaluate_odometry

    with progress() as bar:
        task = bar.add_task("evaluating", total=None)
        rows, without = evaluate_odometry(
            bucket,
            truth,
            frames=_range(frames),
            settings=settings.mining(),
            odometries=odometry or (),
            on_progress=lambda done: bar.update(task, completed=done),
        )
    _name_logs(without, "poses")
    if json:
        for row in rows:
            json_line(row)
        return
    table(
        "relative pose errors; per frame, and per 100 m over segments of 100 to 800 m",
        (
            *("log", "odometry", "compared with", "frames", "path m", "m per frame"),
            *("95 % of logs", "deg per frame", "m per 100 m", "deg per 100 m", "end, m per 100 m"),
        ),
        (
            (
                *(row.log, row.odometry, row.compared_with, row.frames, row.path_m),
                *(row.translation_m, _interval(row.interval), row.rotation_deg),
                *(row.translation_m_per_100_m, row.rotation_deg_per_100_m),
                row.end_error_m_per_100_m,
            )
            for row in _shown(rows)
        ),
    )


def _shown(rows: "Sequence[_Row]") -> "Sequence[_Row]":
    """Return the rows of a table: those of all logs are left out where there is only one log."""
    return rows if len({row.log for row in rows}) > 2 else [r for r in rows if r.log != "all"]


def _range(frames: str) -> range:
    first, last = parse_frames(frames)
    return range(first, sys.maxsize if last is None else last)


def _name_logs(logs: Iterable[str], what: str) -> None:
    for log in logs:
        remark(f"{log} is left out: its truth has no {what.removeprefix('true ')}")


def _interval(interval: "Interval | None") -> str | None:
    return None if interval is None else f"{interval.low:.3f} to {interval.high:.3f}"
