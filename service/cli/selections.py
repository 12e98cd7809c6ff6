"""Verbs on selections: `select`, `selection list`, `selection show`."""

import time
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Annotated, Final

import typer

from schemas.bounds import MAX_NAME, MAX_SCENES_ASKED
from schemas.errors import PermanentError
from service.api.messages import checked_request
from service.api.reader import Reader
from service.cli.listing import listed, say_classes
from service.cli.option_groups import grouped
from service.cli.options import Config, Connect, Database, Json, StateToRead
from service.cli.output import counted, json_line, page, remark, result_line, table
from service.cli.report import say_scenes
from service.cli.scene_filters import SceneFilters
from service.cli.scenes import reader
from service.curation.candidates import Proposal
from service.curation.listing import MAX_PAGE, ScenesRequest
from service.curation.ranking import RankedScene, has_reason
from service.curation.scene_names import short_names
from service.curation.selection import Selection, SelectionTerms, left_out, why_no_reason
from service.curation.strategies.catalogue import DEFAULT, STRATEGIES, strategy_named
from service.curation.twins import is_in_place
from service.errors import UsageError
from service.export.json_lines import json_lines

MOST_LEFT_OUT: Final = 5
"""Scenes that are named for each cause of leaving them out, or as gone; others are counted."""

_STRATEGIES: Final = ", ".join(row.name for row in STRATEGIES)

SelectionName = Annotated[str, typer.Argument(help="Name, as `selection list` prints it.")]


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(epilog="counterpoint select --budget 50 --name week-47")(select)
    selection = typer.Typer(no_args_is_help=True, help="List and show stored selections.")
    selection.command("list", epilog="counterpoint selection list")(list_selections)
    selection.command("show", epilog="counterpoint selection show week-47 --json")(show_selection)
    app.add_typer(selection, name="selection")


@grouped
def select(
    *,
    budget: Annotated[
        int,
        typer.Option(
            "--budget",
            min=1,
            max=MAX_SCENES_ASKED,
            help="Number of scenes that the labellers can take.",
        ),
    ],
    name: Annotated[str | None, typer.Option("--name", help="Name of the selection.")] = None,
    strategy: Annotated[
        str, typer.Option("--strategy", help=f"Strategy of the choice: {_STRATEGIES}.")
    ] = DEFAULT,
    again: Annotated[
        bool, typer.Option("--again", help="Also choose scenes that earlier selections contain.")
    ] = False,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Explain each choice in a line, and store nothing."),
    ] = False,
    filters: SceneFilters,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Choose scenes that no earlier selection contains, store them under a name, publish them."""
    if name is not None:
        _need_name(name, option="--name")
    source = reader(config, connect=connect, state=state, database=database)
    terms = terms_of(strategy=strategy, again=again, filters=filters)
    if dry_run:
        _say_proposal(source.propose(budget=budget, name=name, terms=terms), json=json)
        return
    selection = source.select(budget=budget, name=name, terms=terms)
    if json:
        _print_json(selection)
        return
    ranking = source.top(selection.last_rank)
    say_selection(selection, among=ranking)
    say_left_out(selection, ranking, terms)
    if filters.class_name and not selection.scenes:
        say_classes(source)
    remark("ids for a labelling tool: --json, or the published selection")


def terms_of(*, strategy: str, again: bool, filters: SceneFilters) -> SelectionTerms:
    """Make the terms of a selection of what a user gave.

    Raises:
        UsageError: If a value is invalid, or there is no such strategy.
    """
    strategy_named(strategy)
    asked = filters.request(now_s=time.clock_gettime(time.CLOCK_REALTIME))
    return SelectionTerms(strategy=strategy, again=again, filters=asked)


def _say_proposal(proposal: Proposal, *, json: bool) -> None:
    if json:
        for choice in proposal.choices:
            json_line(choice)
        return
    names = short_names([choice.scene for choice in proposal.choices])
    for number, choice in enumerate(proposal.choices, start=1):
        where = f"rank {choice.scene.rank}, {names[choice.scene.scene_id]}"
        result_line(f"{number}. {where}: adds {choice.gain:.3f}; {choice.why}")
    remark(
        f"{len(proposal.choices)} of at most {counted(proposal.budget, 'scene')} by "
        f"{proposal.strategy}; nothing is stored"
    )
    if proposal.taken:
        remark(f"{counted(proposal.taken, 'scene')} of earlier selections left out; --again: kept")


def list_selections(
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """List the stored selections, oldest first."""
    found = reader(config, connect=connect, state=state, database=database).selections()
    if json:
        for row in found:
            json_line(row)
        return
    table(
        counted(len(found), "selection"),
        ("name", "strategy", "scenes", "budget", "stored (UTC)"),
        ((row.name, row.strategy, row.scenes, row.budget, _utc(row.created_s)) for row in found),
    )


def show_selection(
    name: SelectionName,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Show a stored selection: its scenes with their ranks of that time."""
    _need_name(name, option="NAME")
    source = reader(config, connect=connect, state=state, database=database)
    selection = source.selection(name)
    if json:
        _print_json(selection)
        return
    say_selection(selection, among=selection.scenes)
    _say_withdrawn(source, selection)


def _say_withdrawn(source: Reader, selection: Selection) -> None:
    """Print a line for each of the first scenes that are no longer current, with the cause."""
    request = checked_request(ScenesRequest, selection=selection.name, most=MAX_PAGE)
    current = {row.scene_id for row in listed(source, request, most=None)[0]}
    gone = [row for row in selection.scenes if row.scene_id not in current]
    for row in gone[:MOST_LEFT_OUT]:
        try:
            source.scene(row.scene_id)
        except PermanentError as error:
            remark(f"rank {row.rank} is no longer listed: {error}")
    if (others := len(gone) - MOST_LEFT_OUT) > 0:
        remark(f"{others} more are no longer listed")


def say_selection(selection: Selection, *, among: Sequence[RankedScene]) -> None:
    """Print the scenes of a selection, best first."""
    by = f" by {selection.strategy}" if selection.strategy else ""
    say_scenes(
        f"selection {selection.name!r}{by}: {len(selection.scenes)} of at most "
        f"{counted(selection.budget, 'scene')}",
        selection.scenes,
        among=among,
    )


def say_left_out(
    selection: Selection, ranking: Sequence[RankedScene], terms: SelectionTerms
) -> None:
    """Print a line for each of the first scenes that a selection left out, with the cause."""
    names, rank_of = short_names(ranking), {row.scene_id: row.rank for row in ranking}
    passed = left_out(ranking, selection)
    causes = (
        "selected earlier" if not terms.again else "",
        "filtered" if terms.filters is not None else "",
        "like a chosen scene" if terms.strategy != DEFAULT else "",
    )
    cause = " or ".join(filter(None, causes)) or "new since the choice"

    def why(row: RankedScene) -> str:
        if not has_reason(row):
            return f"no reason, {why_no_reason(row)}"
        if row.twin_of is None:
            return cause
        if is_in_place(row.scene_id, row.twin_of):
            return f"same place as rank {rank_of.get(row.twin_of)}, which shows the same"
        return f"twin of rank {rank_of.get(row.twin_of)}, which shows the same"

    kinds = (
        (passed.twins, "twins"),
        (passed.others, "with a reason"),
        (passed.without, "without a reason"),
    )
    for rows, what in kinds:
        for row in rows[:MOST_LEFT_OUT]:
            scene = f"rank {row.rank}, {row.score:.3f}, {names[row.scene_id]}"
            remark(f"left out: {scene}: {why(row)}")
        if (others := len(rows) - MOST_LEFT_OUT) > 0:
            remark(f"left out: {others} more {what}")
    if selection.last_rank is not None:
        remark(f"the budget is used up at rank {selection.last_rank}; later ones were not compared")


def _need_name(name: str, *, option: str) -> None:
    if not (0 < len(name) <= MAX_NAME and name.isprintable()):
        raise UsageError(f"{option} must have 1 to {MAX_NAME} printing characters, got {name!r}")


def _print_json(selection: Selection) -> None:
    for line in json_lines(selection):
        page(line)


def _utc(created_s: float) -> str:
    return datetime.fromtimestamp(created_s, tz=UTC).strftime("%Y-%m-%d %H:%M")
