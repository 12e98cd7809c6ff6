"""Verb `calibrate motion`: fits the thresholds of the paper's two-stage rule to logs with truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.options import MOST, BucketOfLogs, Config, Force, Json, Weights, settings_for
from service.cli.output import counted, json_line, progress, remark, table
from service.cli.truth_options import Frames, Truth, parse_frames
from service.errors import UsageError
from service.output_files import need_folder, need_writable, save_text

if TYPE_CHECKING:
    from workers.lab.calibration.motion_thresholds import GridPoint
    from workers.paper.scene_flow import SceneFlowSource

FLOWS = ("registered-clusters", "nearest-neighbour", "flowstep3d")
BEST_ROWS = 5


def motion(
    bucket: BucketOfLogs,
    truth: Truth,
    out: Annotated[Path, typer.Option("--out", help="File of thresholds to write, .json.")],
    frames: Frames = "0:",
    every: Annotated[
        int, typer.Option("--every", min=1, max=MOST, help="Interval of the frames taken.")
    ] = 1,
    flow: Annotated[
        str, typer.Option("--flow", help=f"Scene flow: {', '.join(FLOWS)}.")
    ] = "registered-clusters",
    pictures: Annotated[
        Path | None,
        typer.Option("--pictures", help="Folder for the plots of speeds and of spreads."),
    ] = None,
    weights: Weights = None,
    json: Json = False,
    config: Config = None,
    force: Force = False,
) -> None:
    """Fit the thresholds of the streams `two-stage` to a flow, by a grid search on truth.

    The file is for the setting `motion_rule`. Evaluate it on other frames than those of --frames.
    """
    from workers.lab.calibration.motion_plots import draw_speeds, draw_spreads
    from workers.lab.calibration.motion_samples import collect_samples
    from workers.lab.calibration.motion_thresholds import (
        instance_spreads,
        search_thresholds,
        speed_overlap,
    )
    from workers.lab.plots import need_matplotlib
    from workers.parts.registry import build_odometry

    need_writable(out, option="--out", force=force, endings=(".json",))
    if pictures is not None:
        need_matplotlib()
        need_folder(pictures, option="--pictures")
    settings = settings_for(config, weights=weights)
    source = _source(flow, settings.weights)
    with progress() as bar:
        task = bar.add_task("flow", total=None)
        samples = collect_samples(
            *(bucket, truth),
            source=source,
            odometry=build_odometry(settings.odometry),
            settings=settings.mining(),
            frames=parse_frames(frames),
            every=every,
            on_progress=lambda done: bar.update(task, completed=done),
        )
        task = bar.add_task("grid", total=len(samples))
        grid = search_thresholds(
            samples, on_progress=lambda done, total: bar.update(task, completed=done, total=total)
        )
    overlap, spreads = speed_overlap(samples), instance_spreads(samples)
    best, published = grid[0], next(each for each in grid if _is_published(each))
    save_text(best.rule.model_dump_json(indent=1) + "\n", out, option="--out", force=force)
    if pictures is not None:
        draw_speeds(pictures / "speeds.png", overlap, best.rule)
        draw_spreads(pictures / "spreads.png", spreads, best.rule)
    if json:
        json_line(
            {
                "frames": len(samples),
                "overlap": overlap.overlap,
                "best": {"iou": best.iou, **best.rule.model_dump()},
                "published": {"iou": published.iou, **published.rule.model_dump()},
            }
        )
        return
    _say([*grid[:BEST_ROWS], published])
    moving = [each.spread for each in spreads if each.dynamic]
    remark(
        f"{counted(len(samples), 'frame')}; speeds of static and dynamic points overlap by "
        f"{overlap.overlap:.2f}; {len(moving)} of {counted(len(spreads), 'true instance')} move"
    )
    remark(f"{out}: next: counterpoint eval motion {bucket} --truth {truth} --stream two-stage:…")


def _say(rows: "list[GridPoint]") -> None:
    table(
        "thresholds, best dynamic IoU first; the last row has the published ones",
        ("IoU", "spread", "speeds apart m/s", "slowest km/h", "hits", "false", "missed"),
        (
            (
                f"{each.iou:.3f}",
                each.rule.max_spread,
                each.rule.flow_reach_m_per_s,
                f"{each.rule.min_speed_m_per_s * 3.6:.0f}",
                *(each.hits, each.false, each.missed),
            )
            for each in rows
        ),
    )


def _is_published(each: "GridPoint") -> bool:
    from schemas.motion_rule import PER_SECOND

    return each.rule == PER_SECOND


def _source(flow: str, weights: str) -> "SceneFlowSource":
    from workers.paper.learned_flow import FlowStep3DFlow
    from workers.paper.rigid_flow import rigid_flow
    from workers.paper.scene_flow import nearest_neighbour_flow

    if flow not in FLOWS:
        raise UsageError(f"--flow: {flow!r} is none of {', '.join(FLOWS)}")
    if flow == "flowstep3d":
        if not weights:
            raise UsageError("--flow flowstep3d needs --weights FOLDER")
        return FlowStep3DFlow.load(Path(weights))
    return rigid_flow if flow == "registered-clusters" else nearest_neighbour_flow
