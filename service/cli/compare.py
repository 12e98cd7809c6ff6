"""Verb `compare`: the release gate of two software versions, pipeline versions, or states."""

import time
from pathlib import Path
from typing import Annotated, Final, get_args

import typer

from schemas.bounds import MAX_NAME
from service.api.messages import checked_request
from service.api.reader import Reader
from service.api.state_reader import StateReader
from service.cli.options import Config, Connect, Database, Force, Json, StateToRead, settings_for
from service.cli.output import counted, json_line, remark, result_line, table
from service.cli.scenes import reader
from service.curation.compared_scenes import NamedSide
from service.curation.comparing import compare as compare_sides
from service.curation.comparison import (
    MAX_TOLERANCE,
    ComparedGroup,
    ComparedSide,
    CompareRequest,
    Comparison,
    ComparisonTerms,
    Match,
    Rate,
)
from service.curation.comparison_report import gate_sentence, group_name, markdown, place_lines
from service.curation.rates import instants_ns
from service.errors import UsageError
from service.output_files import need_writable, save_text

EX_REGRESSED: Final = 3
"""Exit code of a comparison that B did not pass."""

FIELDS: Final = ("software", "pipeline", "state", "vehicle", "since", "until")

_MOST_PLACES: Final = 5
"""Compared places that are printed; `--json` and `--markdown` have more."""

_SIDE_HELP: Final = (
    "{what}: software=2026.1, pipeline=NAME or state=DIR; further terms after commas: "
    "vehicle=, since=, until=."
)


def add_to(app: typer.Typer) -> None:
    """Add the verb of this file to the command."""
    app.command(epilog="counterpoint compare --a software=2026.1 --b software=2026.2")(compare)


def compare(
    a: Annotated[str, typer.Option("--a", help=_SIDE_HELP.format(what="Version before"))],
    b: Annotated[str, typer.Option("--b", help=_SIDE_HELP.format(what="Version to release"))],
    tolerance: Annotated[
        float,
        typer.Option(
            "--tolerance",
            min=0.0,
            max=MAX_TOLERANCE,
            help="Share by which a rate of B may exceed that of A: 0.1 allows 10 % more.",
        ),
    ] = 0.0,
    match: Annotated[
        str,
        typer.Option(
            "--match", help="logs: the very same logs; roads: the same kind of road; or auto."
        ),
    ] = "auto",
    report: Annotated[
        Path | None, typer.Option("--markdown", help="Write a report in Markdown to this file.")
    ] = None,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
    force: Force = False,
) -> None:
    """Compare two versions, and end with 3 if a group of tracks regressed, or B answers less."""
    if report is not None:
        need_writable(report, option="--markdown", force=force, endings=(".md",))
    if match not in get_args(Match):
        raise UsageError(f"--match: {match!r} is none of {', '.join(get_args(Match))}")
    now_s = time.clock_gettime(time.CLOCK_REALTIME)
    sides = [side_of(said, option, now_s=now_s) for said, option in ((a, "--a"), (b, "--b"))]
    terms = checked_request(ComparisonTerms, match=match, tolerance=tolerance)
    if any(folder is not None for folder, _ in sides):
        if connect is not None:
            raise UsageError("state= reads folders here, and --connect asks a service: give one")
        named = [
            _read(folder, side, name, config, state=state, database=database)
            for (folder, side), name in zip(sides, (a, b), strict=True)
        ]
        found = compare_sides(named[0], named[1], terms)
    else:
        source: Reader = reader(config, connect=connect, state=state, database=database)
        found = source.compare(CompareRequest(a=sides[0][1], b=sides[1][1], terms=terms))
    if report is not None:
        save_text(markdown(found), report, option="--markdown", force=force)
    if json:
        json_line(found)
    else:
        _say(found)
    if not found.passed:
        raise typer.Exit(EX_REGRESSED)


def side_of(said: str, option: str, *, now_s: float) -> tuple[Path | None, ComparedSide]:
    """Parse a side as a user gave it: its state folder, None for the usual one, and its terms.

    Raises:
        UsageError: If a term is unknown, given twice, without a value, or no time.
    """
    terms: dict[str, str] = {}
    for part in said.split(","):
        field, equals, value = (each.strip() for each in part.partition("="))
        if field not in FIELDS or not equals or not value or field in terms:
            raise UsageError(
                f"{option}: {part!r} is no term of a version; give such as software=2026.1, of "
                f"{', '.join(FIELDS)}, each once, with commas between"
            )
        terms[field] = value
    since_ns, until_ns = instants_ns(
        since=terms.get("since", ""), until=terms.get("until", ""), now_s=now_s
    )
    for field in ("software", "pipeline", "vehicle"):
        if len(terms.get(field, "")) > MAX_NAME:
            raise UsageError(f"{option}: {field} is longer than {MAX_NAME} characters")
    folder = Path(terms["state"]) if "state" in terms else None
    return folder, checked_request(
        ComparedSide,
        software_version=terms.get("software"),
        pipeline_version=terms.get("pipeline"),
        vehicle=terms.get("vehicle"),
        since_ns=since_ns,
        until_ns=until_ns,
    )


def _read(
    folder: Path | None,
    side: ComparedSide,
    name: str,
    config: Path | None,
    *,
    state: Path | None,
    database: str | None,
) -> NamedSide:
    """Read a side from its state, or from the usual one."""
    source = reader(
        config, connect=None, state=folder or state, database=None if folder else database
    )
    if not isinstance(source, StateReader):
        settings = settings_for(config)
        raise UsageError(
            f"one side names a state, and the other is at {settings.connect}: name a state for both"
        )
    return source.compared_side(side, name=name)


def _say(found: Comparison) -> None:
    same = found.matched == "logs"
    table(
        f"B against A: {found.b.name} against {found.a.name}",
        (
            *("group", "A per hour", "B per hour", "B - A, corrected", "p", "result"),
            *(("gone", "new") if same else ()),
        ),
        (
            (
                group_name(row),
                _rate(row.a),
                _rate(row.b),
                f"{row.difference:+.1f} ({row.corrected_low:.1f} to {row.corrected_high:.1f})",
                f"{row.corrected_p:.3g}",
                "" if row.outcome == "same" else row.outcome,
                *((row.gone, row.new) if same else ()),
            )
            for row in found.groups
        ),
    )
    for row in found.groups:
        _say_examples(row)
    result_line(gate_sentence(found))
    for name, side, other in (("A", found.a, "B"), ("B", found.b, "A")):
        share = side.labelled_share
        labels = f", {100 * share:.1f} % of the returns labelled" if share < 1.0 else ""
        what = "of a log" if same else "on a kind of road"
        out = f"; {counted(side.left_out, 'scene')} {what} that {other} lacks, left out"
        remark(
            f"{name}: {counted(side.logs, 'log')}, {counted(side.scenes, 'scene')}, "
            f"{side.hours:.3f} h{labels}{out if side.left_out else ''}"
        )
    for line in place_lines(found, most=_MOST_PLACES):
        remark(line)
    if found.too_few:
        remark(f"{counted(found.too_few, 'group')} with too few tracks or logs, not compared")
    if not found.modes:
        remark("modes are not compared: they need scikit-learn, counterpoint[curation]")


def _say_examples(row: ComparedGroup) -> None:
    for each in row.examples:
        result_line(
            f"{group_name(row)} {row.outcome}: {each.scene_id}, track {each.track_id + 1}, "
            f"{each.headline}"
        )


def _rate(rate: Rate) -> str:
    return f"{rate.per_hour:.1f} ({rate.low:.1f} to {rate.high:.1f})"
