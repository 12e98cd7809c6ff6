"""Verb `demo`: mines, ranks and draws a small simulated fleet, and compares it with its truth."""

import sys
import time
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from service.cli.options import LogFormat, LogLevel, log_as
from service.cli.output import command, counted, listing, progress, remark, table
from service.cli.review import OPEN, has_extra, serve_until_stopped

if TYPE_CHECKING:
    from service.demo.planted import DemoScene

DEMO_ROWS: Final = 12


def add_to(app: typer.Typer) -> None:
    """Add the verb of this file to the command."""
    app.command(epilog="counterpoint demo --out demo-output")(demo)


def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for logs, state and pictures.")] = Path(
        "demo-output"
    ),
    workers: Annotated[int, typer.Option("--workers", help="Worker processes.")] = 2,
    log_format: LogFormat = None,
    log_level: LogLevel = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Replace fleet/, state/ and pictures/ even if no demo made them."
        ),
    ] = False,
) -> None:
    """Simulate street logs, mine them, rank the scenes, draw the best ones.

    On a terminal the review page is served at the end, until Ctrl-C.
    """
    from service.cli.report import say_what_was_found
    from service.demo.run import demo_settings, run_demo

    settings = demo_settings(out, workers=workers, log_format=log_format, log_level=log_level)
    log_as(settings, is_daemon=True)
    result = run_demo(
        out,
        settings=settings,
        remark=remark,
        progress=progress,
        now_s=time.clock_gettime(time.CLOCK_REALTIME),
        force=force,
    )
    say_what_was_found(result.status)
    say_demo_ranking(result.scenes)
    say_chosen(result.scenes, result.chosen)
    failing = sum(bool(scene.failures) for scene in result.scenes)
    named = sum(scene.named is True for scene in result.scenes)
    remark(
        f"the first reason is about the planted failure in {named} of "
        f"{counted(failing, 'scene')} with a failure"
    )
    table(
        f"how well rankings find the {failing} of {len(result.scenes)} scenes with a "
        "planted failure",
        ("ranked by", "average precision", "precision of the first 10 %", "of the first 20 %"),
        (
            (each.name, each.ap, each.precision_at["10"], each.precision_at["20"])
            for each in result.found
        ),
    )
    for path in result.pictures:
        remark(f"picture: {path}")
    state = out / "state"
    remark(f"more: {command()} top --state {state}")
    remark(f"any scene by its rank: {command()} show 1 --state {state} --out scene.png")
    remark(f"the best for the labellers: {command()} select --budget 4 --state {state}")
    remark(f"your own logs: {command()} run --bucket FOLDER --once")
    if sys.stdin.isatty() and sys.stderr.isatty() and has_extra():
        serve_until_stopped(settings)
    else:
        remark(f"{OPEN}: {command()} review --state {state}")


def say_demo_ranking(scenes: "Sequence[DemoScene]", *, most: int = DEMO_ROWS) -> None:
    """Print the best scenes, and below them the others with a planted failure."""
    rank_of = {scene.row.scene_id: scene.row.rank for scene in scenes}
    shown = [scene for scene in scenes if scene.row.rank <= most or scene.failures]
    listing(
        f"{counted(len(scenes), 'scene')}: the best {most}, and of the others those with a planted "
        "failure",
        ("rank", "score", "scene", "twin of", "reason names it", "planted"),
        (
            (
                (
                    scene.row.rank,
                    scene.record.score,
                    scene.name,
                    rank_of[scene.row.twin_of] if scene.row.twin_of else None,
                    None if scene.named is None else "yes" if scene.named else "no",
                    scene.planted,
                ),
                scene.headline,
            )
            for scene in shown
        ),
    )


def say_chosen(scenes: "Sequence[DemoScene]", chosen: Collection[str]) -> None:
    """Print how many scenes with a planted failure a selection takes, and each that it leaves."""
    failing = [scene for scene in scenes if scene.failures]
    missed = [scene for scene in failing if scene.row.scene_id not in chosen]
    remark(
        f"a selection of all distinct scenes with a reason takes {counted(len(chosen), 'scene')}: "
        f"{len(failing) - len(missed)} of the {len(failing)} with a planted failure, and "
        f"{len(chosen) - len(failing) + len(missed)} of the others"
    )
    for scene in missed:
        why = "a twin" if scene.row.twin_of else "without a reason"
        remark(f"not selected: {scene.name}, rank {scene.row.rank}, {scene.planted}: {why}")
