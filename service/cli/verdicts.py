"""Verbs on verdicts: `verdict add`, `verdict undo`, `verdict list`, `agreement`."""

import getpass
import os
import uuid
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Annotated, Final

import typer

from schemas.bounds import MAX_NAME
from schemas.verdict import GIVEN, Verdict, VerdictRow
from service.api.messages import checked_request
from service.cli.options import MOST, Config, Connect, Database, Json, StateToRead
from service.cli.output import counted, json_line, remark, result_line, table
from service.cli.scenes import find_scene, reader
from service.curation.verdicts import (
    CAUSES,
    FEW_ITEMS,
    MAX_VERDICTS_ASKED,
    AgreementReply,
    AgreementRequest,
    JudgeRequest,
    Precision,
    UndoRequest,
    VerdictsRequest,
)
from service.errors import UsageError

_STANDING: Final = {
    "current": "",
    "replaced": "of an earlier record: the scene was mined again",
    "withdrawn": "the scene is no longer current",
}

Reviewer = Annotated[
    str | None, typer.Option("--reviewer", help="Who judges; default: the user of this machine.")
]
SceneNamed = Annotated[
    str, typer.Argument(help="Rank, name in `counterpoint top`, or scene_id.", metavar="SCENE")
]
Track = Annotated[
    int | None,
    typer.Option(
        "--track", min=1, max=MOST, help="Track as pictures number it, instead of the scene."
    ),
]
Key = Annotated[
    str | None,
    typer.Option("--key", help="Name of this write: the same one again is stored once."),
]


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    verdict = typer.Typer(no_args_is_help=True, help="Judge scenes, and list the verdicts.")
    verdict.command("add", epilog="counterpoint verdict add 1 supervised --cause brief_stop")(add)
    verdict.command("undo", epilog="counterpoint verdict undo")(undo)
    verdict.command("list", epilog="counterpoint verdict list --reviewer ann")(list_verdicts)
    app.add_typer(verdict, name="verdict")
    app.command(epilog="counterpoint agreement --selection week-47")(agreement)


def add(
    scene: SceneNamed,
    verdict: Annotated[
        str,
        typer.Argument(
            help=f"Stream that is wrong: {', '.join(each.value for each in GIVEN)}.",
            metavar="VERDICT",
        ),
    ],
    reviewer: Reviewer = None,
    track: Track = None,
    cause: Annotated[
        str, typer.Option("--cause", help=f"One of {', '.join(CAUSES)}, or of the setting causes.")
    ] = "",
    note: Annotated[str, typer.Option("--note", help="Your own words.")] = "",
    duplicate_of: Annotated[
        str | None, typer.Option("--duplicate-of", help="The scene that shows the same.")
    ] = None,
    key: Key = None,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Judge a scene, or one of its tracks: which stream is wrong."""
    if verdict not in {each.value for each in GIVEN}:
        known = ", ".join(each.value for each in GIVEN)
        raise UsageError(f"no verdict {verdict!r}; one of: {known}")
    source = reader(config, connect=connect, state=state, database=database)
    request = checked_request(
        JudgeRequest,
        key=key or uuid.uuid4().hex,
        scene_id=find_scene(source, scene)[0],
        track_id=_id_of(track),
        reviewer=_name(reviewer),
        verdict=Verdict(verdict),
        cause=cause,
        note=note,
        duplicate_of=find_scene(source, duplicate_of)[0] if duplicate_of else None,
    )
    _say_stored(source.judge(request), json=json)


def undo(
    scene: Annotated[
        str | None,
        typer.Argument(help="Its rank, name or scene_id; default: the last one of all."),
    ] = None,
    reviewer: Reviewer = None,
    track: Track = None,
    key: Key = None,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Undo the reviewer's last verdict; the one before it on that scene counts again."""
    if track is not None and scene is None:
        raise UsageError("--track needs its scene")
    source = reader(config, connect=connect, state=state, database=database)
    request = checked_request(
        UndoRequest,
        key=key or uuid.uuid4().hex,
        reviewer=_name(reviewer),
        scene_id=find_scene(source, scene)[0] if scene else None,
        track_id=_id_of(track),
    )
    _say_stored(source.undo(request), json=json)


def list_verdicts(
    scene: Annotated[
        str | None, typer.Option("--scene", help="Only of this scene: rank, name or scene_id.")
    ] = None,
    reviewer: Annotated[str | None, typer.Option("--reviewer", help="Only of this one.")] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Also undone and replaced ones, and undos.")
    ] = False,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """List the verdicts, latest first."""
    source = reader(config, connect=connect, state=state, database=database)
    request = checked_request(
        VerdictsRequest,
        scene_id=find_scene(source, scene)[0] if scene else None,
        reviewer=reviewer,
        current=not everything,
        most=MAX_VERDICTS_ASKED,
    )
    rows: list[VerdictRow] = []
    while True:
        page = source.verdicts(request)
        rows += page.rows
        if page.next is None:
            break
        request = request.model_copy(update={"before": page.next})
    if json:
        for row in rows:
            json_line(row)
        return
    table(
        counted(len(rows), "verdict"),
        ("number", "given (UTC)", "reviewer", "verdict", "cause", "track", "scene", "remark"),
        (
            (
                row.ordinal,
                datetime.fromtimestamp(row.judged_s, tz=UTC).strftime("%Y-%m-%d %H:%M:%S"),
                row.reviewer,
                row.verdict.value,
                row.cause,
                _number_of(row.track_id),
                row.scene_id,
                "; ".join(filter(None, (_STANDING[row.record], row.note))),
            )
            for row in rows
        ),
    )


def agreement(
    selection: Annotated[
        str | None, typer.Option("--selection", help="Only the scenes of this selection.")
    ] = None,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Show the pace of each reviewer, their agreement, conflicts and the precision so far."""
    source = reader(config, connect=connect, state=state, database=database)
    found = source.agreement(checked_request(AgreementRequest, selection=selection))
    if json:
        json_line(found)
        return
    _say_agreement(found)


def _say_agreement(found: AgreementReply) -> None:
    of = "" if found.budget is None else f" of {found.budget}"
    table(
        "reviewers",
        ("reviewer", "scenes", "verdicts", "seconds each"),
        (
            (
                pace.reviewer,
                f"{pace.scenes}{of}",
                pace.verdicts,
                None if pace.median_s is None else f"{pace.median_s:.0f}",
            )
            for pace in found.pace
        ),
    )
    if found.pairs:
        table(
            "agreement of two: Cohen's kappa, 1 full, 0 as by chance",
            ("one", "other", "both judged", "agreed", "kappa"),
            (
                (
                    pair.one,
                    pair.other,
                    pair.items,
                    pair.agreed,
                    said_of_kappa(pair.kappa, items=pair.items),
                )
                for pair in found.pairs
            ),
        )
    if found.conflicts:
        table(
            counted(found.conflicting, "conflict"),
            ("scene", "track", "verdicts"),
            (
                (each.scene_id, _number_of(each.track_id), _given(each.verdicts))
                for each in found.conflicts
            ),
        )
    remark(said_of_precision(found.precision))


def said_of_precision(precision: Precision) -> str:
    """Describe the precision so far in a sentence."""
    if precision.share is None or precision.low is None or precision.high is None:
        return "precision so far: no scene is judged"
    return (
        f"precision so far: the supervised stream is wrong on {precision.right} of "
        f"{counted(precision.judged, 'judged scene')}, {precision.share:.0%} "
        f"(95 %: {precision.low:.0%} to {precision.high:.0%})"
    )


def said_of_kappa(kappa: float | None, *, items: int) -> str | None:
    """Return kappa in a table; it states nothing over fewer than `FEW_ITEMS` items."""
    if items < FEW_ITEMS:
        return "too few"
    return None if kappa is None else f"{kappa:.2f}"


def _id_of(number: int | None) -> int | None:
    """Return the `track_id` of a number on pictures."""
    return None if number is None else number - 1


def _number_of(track_id: int | None) -> int | None:
    return None if track_id is None else track_id + 1


def _given(rows: Sequence[VerdictRow]) -> str:
    return ", ".join(f"{row.reviewer}: {row.verdict.value}" for row in rows)


def _say_stored(row: VerdictRow, *, json: bool) -> None:
    if json:
        json_line(row)
        return
    track = "" if row.track_id is None else f" track {_number_of(row.track_id)}"
    result_line(f"[{row.ordinal}] {row.reviewer}: {row.verdict.value}  {row.scene_id}{track}")
    if _STANDING[row.record]:
        remark(
            f"this verdict is {_STANDING[row.record]}"
            if row.record == "replaced"
            else _STANDING[row.record]
        )


def _name(reviewer: str | None) -> str:
    if reviewer is None:
        try:
            reviewer = getpass.getuser()
        except (OSError, KeyError):
            reviewer = f"user-{os.getuid()}"
    if not (0 < len(reviewer) <= MAX_NAME and reviewer.isprintable()):
        raise UsageError(f"--reviewer must have 1 to {MAX_NAME} printing characters")
    return reviewer
