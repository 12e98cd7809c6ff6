"""The verb `demo`: a small simulated fleet, mined, ranked, drawn, and held against its truth."""

import time
from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import LogFormat, LogLevel, log_as
from service.cli.output import progress, remark, table

DEMO_ROWS = 12


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
) -> None:
    """Simulate street logs, mine them, rank the scenes, draw the best ones."""
    from service.cli.report import say_ranking, say_what_was_found
    from service.demo import demo_settings, run_demo

    settings = demo_settings(out, workers=workers, log_format=log_format, log_level=log_level)
    log_as(settings, is_daemon=True)
    result = run_demo(
        out,
        settings=settings,
        remark=remark,
        progress=progress,
        now_s=time.clock_gettime(time.CLOCK_REALTIME),
    )
    say_what_was_found(result.status)
    say_ranking(result.ranking, most=DEMO_ROWS)
    table(
        f"how well rankings find the {result.failing} of {len(result.ranking)} scenes in which the "
        "model on the car errs",
        ("ranked by", "average precision", "precision of the first 10 %", "of the first 20 %"),
        (
            (each.name, each.ap, each.precision_at["10"], each.precision_at["20"])
            for each in result.found
        ),
    )
    for path in result.pictures:
        remark(f"picture: {path}")
    remark(f"more: counterpoint top --state {out / 'state'}")
