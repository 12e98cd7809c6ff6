"""Verb `modes`: the recurring failure modes of the current scenes."""

from typing import Final

import typer

from service.cli.options import Config, Connect, Database, Json, StateToRead
from service.cli.output import counted, json_line, remark, result_line, table
from service.cli.scenes import reader
from service.curation.mode_rows import ModeRow
from service.curation.modes import FIRST_GROUPED

CHANGED: Final = 1.5
"""Factor between the halves of the hours from which a rate is called rising or falling."""


def add_to(app: typer.Typer) -> None:
    """Add the verb to the command."""
    app.command(epilog="counterpoint modes --state counterpoint-state")(modes)


def modes(
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """List failure modes: recurring kinds of tracks on which the supervised stream errs."""
    found = reader(config, connect=connect, state=state, database=database).modes()
    if json:
        for row in found.modes:
            json_line(row)
        return
    table(
        f"{counted(len(found.modes), 'mode')} of {counted(found.tracks, 'strong track')} in "
        f"{found.hours:.2f} hours",
        ("mode", "tracks", "scenes", "per hour", "rate", "vehicles", "versions", "best rank"),
        (
            (
                row.mode_id,
                row.tracks,
                row.scenes,
                f"{row.per_hour:.1f}",
                trend(row),
                len(row.vehicles),
                len(row.software_versions),
                row.examples[0].rank,
            )
            for row in found.modes
        ),
    )
    for row in found.modes:
        examples = ", ".join(each.scene_id for each in row.examples)
        result_line(f"{row.mode_id}: {row.name}; best examples: {examples}")
    if found.tracks < FIRST_GROUPED:
        remark(f"modes are formed from {FIRST_GROUPED} strong tracks on")
    elif found.without:
        remark(f"{counted(found.without, 'track')} of no mode: like too few others")


def trend(row: ModeRow) -> str:
    """Compare the rates of both halves of the hours in a word; empty for one day."""
    if row.later_per_hour is None:
        return ""
    if row.later_per_hour > CHANGED * row.earlier_per_hour:
        return "rising"
    if row.earlier_per_hour > CHANGED * row.later_per_hour:
        return "falling"
    return "steady"
