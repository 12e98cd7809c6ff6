"""Verb `rates`: rate of contradictions by group."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import typer

from service.cli.options import Config, Connect, Database, Force, Json, StateToRead
from service.cli.output import json_line, remark, table
from service.cli.scenes import reader
from service.curation.rates import RateRow, RatesRequest, rates_request
from service.errors import UsageError
from service.output_files import need_writable, save_picture

BAR_CHARACTERS: Final = 20
"""Length of the bar of the worst row, characters; the others in proportion."""

_HEADINGS: Final = {
    "vehicle": "vehicle",
    "version": "software version",
    "kind": "kind",
    "hour": "recorded (UTC)",
    "log": "log",
    "dataset": "data set",
}


def add_to(app: typer.Typer) -> None:
    """Add the verb of this file to the command."""
    app.command(epilog="counterpoint rates --by vehicle --since 7d")(rates)


def rates(
    by: Annotated[
        str, typer.Option("--by", help="Group by vehicle, version, kind, hour, log or dataset.")
    ] = "vehicle",
    since: Annotated[
        str,
        typer.Option(
            "--since",
            help="Recorded at or after: 2026-11-20, 2026-11-20T08:00Z, or an age such as 24h, 7d.",
        ),
    ] = "",
    until: Annotated[str, typer.Option("--until", help="Recorded before; as --since.")] = "",
    plot: Annotated[
        Path | None,
        typer.Option("--plot", help="By dataset: picture of the outcomes of all points, a .png."),
    ] = None,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
    force: Force = False,
) -> None:
    """Show the rate of contradictions by group, over current scenes by time of recording.

    A data set is the first folder of a log's id: with `kitti/car/day/drive.mcap` it is `kitti`.
    """
    if plot is not None:
        if by != "dataset":
            raise UsageError("--plot draws the outcomes by data set: give --by dataset")
        need_writable(plot, option="--plot", force=force, endings=(".png",))
    request = rates_request(
        by, since=since, until=until, now_s=time.clock_gettime(time.CLOCK_REALTIME)
    )
    rows = reader(config, connect=connect, state=state, database=database).rates(request)
    if json:
        for row in rows:
            json_line(row.model_dump(mode="json", exclude_none=True))
        return
    if not rows:
        remark(
            "no current scene was recorded then; --since and --until are times of recording, not "
            "of mining"
            if since or until
            else "no scenes yet"
        )
        return
    _say(rows, request)
    if plot is not None:
        from service.pictures.outcomes import draw_outcomes

        shares = {row.group: row.outcomes for row in rows if row.outcomes is not None}
        save_picture(draw_outcomes(shares), plot, option="--plot", force=force)
        remark(f"{plot}")


def _say(rows: Sequence[RateRow], request: RatesRequest) -> None:
    worst = max(row.disagreement_rate for row in rows)
    judged = any(row.judged_scenes for row in rows)
    heading = _HEADINGS[request.by]
    table(
        "% of compared points on which the streams contradict each other: "
        "█ only semantic, ▒ only predictive dynamic",
        (
            heading,
            "scenes",
            "compared M",
            "%",
            "",
            "semantic",
            "predictive",
            "with points" if request.by == "kind" else "score > 0",
            "gated",
            "mean",
            "best",
            *(("judged", "right") if judged else ()),
        ),
        (
            (
                row.group,
                row.scenes,
                f"{row.compared_points / 1e6:,.1f}",
                _percent(row.disagreement_rate),
                _bar(row, worst=worst),
                _percent(row.only_semantic_dynamic_rate),
                _percent(row.only_predictive_dynamic_rate),
                row.scenes_with_contradictions,
                row.gated_scenes,
                row.mean_score,
                row.best_score,
                *((row.judged_scenes, row.right_scenes) if judged else ()),
            )
            for row in rows
        ),
    )


def _bar(row: RateRow, *, worst: float) -> str:
    if not worst:
        return ""
    whole = round(BAR_CHARACTERS * row.disagreement_rate / worst)
    semantic = round(BAR_CHARACTERS * row.only_semantic_dynamic_rate / worst)
    return "█" * min(semantic, whole) + "▒" * max(0, whole - semantic)


def _percent(share: float) -> str:
    return f"{100 * share:.3f}"
