"""Verbs on results: `watch`, `top`, `show`, `status`."""

import time
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from schemas.bounds import MAX_NEWEST, MAX_SCENES_ASKED
from schemas.errors import PermanentError
from service.api.reader import Reader, choose_endpoint, overlay_of
from service.api.state_reader import StateReader
from service.cli.learned_report import say_learned
from service.cli.listing import ListingOptions, listed, say_classes, say_listed
from service.cli.option_groups import grouped
from service.cli.options import (
    MOST,
    Artifacts,
    BucketUrl,
    Config,
    Connect,
    Database,
    Force,
    Json,
    StateToRead,
    settings_for,
)
from service.cli.output import json_line, remark, result_line
from service.cli.report import (
    said_of,
    say_judged,
    say_ranking,
    say_reasons,
    say_what_was_found,
)
from service.client.merge import SceneEvent
from service.curation.places import text_of
from service.curation.scene_names import is_short_name, named, short_names
from service.errors import NothingFoundError, UsageError
from service.output_files import need_writable, save_picture
from service.settings.config import Settings

STOPPING: Final = "stopping: the link is closed; a second Ctrl-C ends at once"


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(epilog="counterpoint watch --connect tcp/127.0.0.1:7447 --json")(watch)
    app.command(epilog="counterpoint top -n 20 --state counterpoint-state")(top)
    app.command(epilog="counterpoint show 1 --out best.png")(show)
    app.command(epilog="counterpoint status --state counterpoint-state")(status)


def watch(
    connect: Connect = None,
    history: Annotated[
        int | None,
        typer.Option(
            "--history",
            min=0,
            max=MAX_NEWEST,
            help="Number of past scenes, the newest; default: all.",
        ),
    ] = None,
    since: Annotated[
        int | None, typer.Option("--since", min=0, max=MOST, help="Only events after this number.")
    ] = None,
    log: Annotated[
        str, typer.Option("--log", help="Only logs whose id matches; * also crosses /.")
    ] = "*",
    vehicle: Annotated[
        list[str] | None, typer.Option("--vehicle", help="Only this vehicle. Repeatable.")
    ] = None,
    min_score: Annotated[
        float,
        typer.Option("--min-score", min=0, max=1, help="Only scenes with at least this score."),
    ] = 0.0,
    json: Json = False,
    config: Config = None,
) -> None:
    """Subscribe to scored scenes: the history first, then each new one when it is committed."""
    from schemas.runtime.process import stop_on_signals
    from schemas.transport.bus import check_endpoints
    from service.client import watch_scenes

    if history is not None and since is not None:
        raise UsageError("give --history or --since, not both")
    settings = settings_for(config, connect=connect)
    endpoint = choose_endpoint(settings)
    check_endpoints(endpoint.split(","))
    remark(f"watching {endpoint}; end with Ctrl-C")
    with stop_on_signals(partial(remark, STOPPING)) as stop:
        for event in watch_scenes(
            endpoint.split(","),
            root=settings.root,
            history=history,
            since=since,
            log=log,
            vehicle=vehicle or (),
            min_score=min_score,
            stop=stop,
            wait=False,
            locks=settings.locks,
            on_service=_say_service,
        ):
            if json:
                json_line(_watched(event))
            elif (score := event.score) is None:
                result_line(f"[{event.seq}] withdrawn  {event.scene_id}")
            else:
                reason = score.reasons[0].headline if score.reasons else score.state.value
                result_line(f"[{event.seq}] {score.score:.3f}  {score.scene_id}  {reason}")


def _say_service(there: bool) -> None:
    remark("the service is back" if there else "no service answers; waiting for it")


@grouped
def top(
    *,
    n: Annotated[
        int | None,
        typer.Option("-n", min=1, max=MAX_SCENES_ASKED, help="Number of rows; default: all."),
    ] = None,
    learned: Annotated[
        bool,
        typer.Option(
            "--learned", help="Rank by what verdicts teach, where this is better; says its effect."
        ),
    ] = False,
    filters: ListingOptions,
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """List every current scene, the most contradicting first, or those that pass the filters."""
    if learned and filters.any_given():
        raise UsageError("--learned ranks every current scene: leave out the filters and --sort")
    source = reader(config, connect=connect, state=state, database=database)
    if learned:
        say_learned(source.top_learned(n), json=json)
        return
    if filters.any_given():
        now_s = time.clock_gettime(time.CLOCK_REALTIME)
        found, total = listed(source, filters.request(now_s=now_s), most=n)
        say_listed(found, total, json=json)
        if filters.class_name and not found and not json:
            say_classes(source)
        return
    rows = source.top(n)
    if json:
        for row in rows:
            json_line(row)
        return
    say_ranking(rows)
    if rows:
        _say_judged_in_best(source, rows[0].scene_id)


def _say_judged_in_best(source: Reader, scene_id: str) -> None:
    """Print the stream under test, read from the record of the best scene alone."""
    try:
        made_by = source.scene(scene_id).producers
    except PermanentError as error:  # a running service took it back between two questions
        remark(str(error))
        return
    pair = said_of(made_by.supervised, made_by.selfsupervised)
    remark(f"streams of the best scene: {pair}; `counterpoint status` counts all")


def show(
    scene: Annotated[
        str,
        typer.Argument(help="Rank, name in `counterpoint top`, or scene_id."),
    ],
    out: Annotated[Path, typer.Option("--out", help="PNG file to write.")],
    on_image: Annotated[
        bool,
        typer.Option("--on-image", help="On the camera image, which is read from --bucket."),
    ] = False,
    bucket: BucketUrl = None,
    connect: Connect = None,
    state: StateToRead = None,
    artifacts: Artifacts = None,
    database: Database = None,
    config: Config = None,
    force: Force = False,
) -> None:
    """Draw a scene from above in the paper's four colours, with its instances."""
    from service.pictures.scene import draw_scene
    from service.pictures.title import title_of

    need_writable(out, option="--out", force=force, endings=(".png",))
    source = reader(config, connect=connect, state=state, artifacts=artifacts, database=database)
    scene_id, rank, name = find_scene(source, scene)
    score, overlay = source.scene(scene_id), overlay_of(source, scene_id)
    title = title_of(score, rank=rank, name=name)
    if on_image:
        from service.pictures.strongest_frame import draw_on_camera

        picture = draw_on_camera(score, overlay, settings_for(config, bucket=bucket), title=title)
    else:
        picture = draw_scene(score, overlay, title=title)
    save_picture(picture, out, option="--out", force=force)
    where = "" if score.place is None else f", at {text_of(score.place)}"
    remark(f"{out}: {score.scene_id}, score {score.score:.3f}{where}")
    say_judged([score])
    say_reasons(score)


def find_scene(source: Reader, said: str) -> tuple[str, int | None, str]:
    """Find the id, rank and short name of the scene of a rank, short name or id.

    The ranking is not read for an id; rank and name are then unknown.

    Raises:
        NothingFoundError: If there is none.
        UsageError: If several scenes have the name.
    """
    if said.isdecimal():
        rank = int(said) if len(said) < len(str(MOST)) else 0
        rows = source.top(rank) if rank else []
        if not rows or len(rows) < rank:
            raise NothingFoundError(f"no scene of rank {said}; `counterpoint top` lists them")
        return rows[-1].scene_id, rank, short_names(rows)[rows[-1].scene_id]
    if is_short_name(said):
        row = named(said, source.top())
        return row.scene_id, row.rank, said
    return said, None, ""


def status(
    connect: Connect = None,
    state: StateToRead = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Show progress: logs, shards, scenes, rates, damaged stretches, parked work."""
    found = reader(config, connect=connect, state=state, database=database).status()
    if json:
        json_line(found)
        return
    say_what_was_found(found)


def reader(
    config: Path | None,
    *,
    connect: str | None,
    state: Path | None,
    database: str | None,
    artifacts: str | None = None,
) -> Reader:
    """Choose the data source: a state with `--state` or `--database`, a service with `--connect`.

    Without any of them it is the service that the settings name, else the database or the state
    folder.

    Raises:
        UsageError: If both are given.
        NothingFoundError: If there is neither a service nor a state.
    """
    if connect is not None and (state is not None or database is not None):
        raise UsageError("give --connect or --state, not both")
    settings = settings_for(
        config, connect=connect, state=state, database=database, artifacts=artifacts
    )
    if state is None and database is None and settings.connect:
        return _remote(settings)
    if not settings.database and not settings.state.is_dir():
        if settings.state.exists():
            raise NothingFoundError(
                f"this is a file, not a state folder: {settings.state}; name a folder with --state"
            )
        raise NothingFoundError(
            f"no state folder {settings.state}: name one with --state, or a service with --connect"
        )
    return StateReader(settings, now_s=time.clock_gettime(time.CLOCK_REALTIME))


def _remote(settings: Settings) -> Reader:
    from service.client import ControlClient

    return ControlClient(settings.connect.split(","), root=settings.root, locks=settings.locks)


def _watched(event: SceneEvent) -> dict[str, Any]:
    """Flatten an event: its number and digest next to the fields of the record."""
    score = event.score
    if score is None:
        return {"seq": event.seq, "withdrawn": True, "scene_id": event.scene_id}
    about = {"seq": event.seq, "withdrawn": False, "sha256": event.sha256}
    return about | score.model_dump(mode="json")
