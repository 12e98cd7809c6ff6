"""Verb `bench selection`: which strategy finds distinct failures first, and how long it takes."""

from pathlib import Path
from typing import Annotated

import typer

from service.cli.options import MOST, Json
from service.cli.output import json_line, table
from service.errors import UsageError


def selection(
    kept: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Folders of mined logs, as `bench failures --kept` writes them: one fleet."
        ),
    ] = None,
    recurring: Annotated[
        int,
        typer.Option(
            "--recurring",
            min=1,
            max=20,
            help="Also with each log this many times, as if other cars met the same failures.",
        ),
    ] = 1,
    draws: Annotated[
        int,
        typer.Option("--draws", min=0, max=MOST, help="Draws of the bootstrap; 0: no intervals."),
    ] = 200,
    rows: Annotated[
        int,
        typer.Option("--rows", min=0, max=10_000_000, help="Synthetic rows to time; 0: none."),
    ] = 1_000_000,
    json: Json = False,
) -> None:
    """Compare strategies and modes with planted failures; time strategies on synthetic rows."""
    if not kept and not rows:
        raise UsageError("give folders of mined logs, or --rows: there is nothing to measure")
    if kept:
        _say_looks(kept, recurring=recurring, draws=draws, json=json)
        _say_modes(kept, json=json)
    if rows:
        _say_speed(rows, json=json)


def _say_looks(kept: list[Path], *, recurring: int, draws: int, json: bool) -> None:
    from service.evaluation import mined_fleet
    from service.evaluation.scenes_to_look_at import SHARES, looks_rows

    logs = mined_fleet.read_fleets(kept)
    for times in sorted({1, recurring}):
        fleet = mined_fleet.fleet_of(mined_fleet.recurring(logs, times=times))
        found = looks_rows(fleet, draws=draws)
        if json:
            for row in found:
                json_line(row.model_dump(mode="json") | {"times": times})
            continue
        table(
            f"{len(fleet)} scenes, each log {times} times: scenes until a share is found",
            ("order", "of", *(f"{100 * share:.0f} %" for share in SHARES), "fewer for 90 %"),
            (
                (
                    row.order,
                    f"{row.distinct} {row.found}",
                    *(
                        _with_interval(row.looks[key], row.intervals[key])
                        for key in (f"{share:g}" for share in SHARES)
                    ),
                    _percent(row.fewer, row.fewer_interval),
                )
                for row in found
            ),
        )


def _say_modes(kept: list[Path], *, json: bool) -> None:
    from service.evaluation.mined_fleet import read_fleets
    from service.evaluation.modes_figure import modes_figure

    row = modes_figure(read_fleets(kept))
    if json:
        json_line(row)
        return
    table(
        "failure modes against planted kinds",
        (
            *("tracks", "in a mode", "modes", "planted", "kinds"),
            *("mutual information", "with classes", "ids kept"),
        ),
        (
            (
                row.tracks,
                f"{100 * row.in_modes:.0f} %",
                row.modes,
                row.planted,
                row.kinds,
                "" if row.ami is None else f"{row.ami:.2f}",
                "" if row.ami_by_class is None else f"{row.ami_by_class:.2f}",
                "" if row.kept is None else f"{100 * row.kept:.0f} %",
            ),
        ),
    )


def _say_speed(rows: int, *, json: bool) -> None:
    from service.evaluation.synthetic_rows import speed_rows, stream_rows

    timed, streamed = speed_rows(rows), stream_rows(rows)
    if json:
        for row in (*timed, *streamed):
            json_line(row)
        return
    table(
        f"selection from {rows} synthetic rows, one thread",
        ("strategy", "scores", "budget", "processor s", "peak MiB", "compared", "missed at most"),
        (
            (
                row.strategy,
                row.scores,
                row.budget,
                f"{row.seconds:.2f}",
                f"{row.peak_mib:.0f}",
                row.compared,
                f"{row.missed:.3f}",
            )
            for row in timed
        ),
    )
    table(
        "one pass against the greedy choice of all rows",
        ("strategy", "order of the stream", "rows", "budget", "processor s", "share of its value"),
        (
            (row.strategy, row.order, row.rows, row.budget, f"{row.seconds:.2f}", row.share)
            for row in streamed
        ),
    )


def _with_interval(value: int | None, interval: tuple[float, float] | None) -> str:
    if value is None:
        return "never"
    return f"{value}" if interval is None else f"{value} ({interval[0]:.0f} to {interval[1]:.0f})"


def _percent(value: float | None, interval: tuple[float, float] | None) -> str:
    if value is None:
        return ""
    if interval is None:
        return f"{100 * value:.0f} %"
    return f"{100 * value:.0f} % ({100 * interval[0]:.0f} to {100 * interval[1]:.0f})"
