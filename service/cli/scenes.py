"""Verbs on what was found: `watch`, `top`, `select`, `show`, `status`."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from schemas.bounds import MAX_NAME, MAX_NEWEST, MAX_SCENES_ASKED
from schemas.errors import PermanentError
from service.api.reader import Reader, StateReader, choose_endpoint, overlay_of
from service.cli.options import (
    MOST,
    Artifacts,
    Config,
    Connect,
    Database,
    Force,
    Json,
    settings_for,
)
from service.cli.output import counted, json_line, remark, result_line, table
from service.cli.report import first_of, said_of, say_judged, say_ranking, say_what_was_found
from service.client.merge import SceneEvent
from service.curation.scene_names import is_short_name, named, short_names
from service.curation.selection import left_out
from service.errors import NothingFoundError, UsageError
from service.output_files import need_writable, save_picture
from service.settings.config import Settings

StateDir = Annotated[
    Path | None, typer.Option("--state", help="Folder of a run; no daemon is needed then.")
]


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(epilog="counterpoint watch --connect tcp/127.0.0.1:7447 --json")(watch)
    app.command(epilog="counterpoint top -n 20 --state counterpoint-state")(top)
    app.command(epilog="counterpoint select --budget 50 --name week-47")(select)
    app.command(epilog="counterpoint show 1 --out best.png")(show)
    app.command(epilog="counterpoint status --state counterpoint-state")(status)


def watch(
    connect: Connect = None,
    history: Annotated[
        int | None,
        typer.Option(
            "--history", min=0, max=MAX_NEWEST, help="Newest scenes first; all by default."
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
        float, typer.Option("--min-score", min=0, max=1, help="Only scenes that score so much.")
    ] = 0.0,
    json: Json = False,
    config: Config = None,
) -> None:
    """Subscribe to scored scenes: the history first, then each as it is committed."""
    from schemas.runtime.process import stop_on_signals
    from schemas.transport.bus import check_endpoints
    from service.client import watch_scenes

    if history is not None and since is not None:
        raise UsageError("give --history or --since, not both")
    settings = settings_for(config, connect=connect)
    endpoint = choose_endpoint(settings)
    check_endpoints(endpoint.split(","))
    remark(f"watching {endpoint}; end with Ctrl-C")
    with stop_on_signals() as stop:
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


def top(
    n: Annotated[
        int | None, typer.Option("-n", min=1, max=MAX_SCENES_ASKED, help="Rows; all by default.")
    ] = None,
    connect: Connect = None,
    state: StateDir = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """List every current scene, the most contradicting first."""
    source = reader(config, connect=connect, state=state, database=database)
    rows = source.top(n)
    if json:
        for row in rows:
            json_line(row)
        return
    say_ranking(rows)
    if rows:
        _say_judged_in_best(source, rows[0].scene_id)


def _say_judged_in_best(source: Reader, scene_id: str) -> None:
    """Say whose labels the best scene judges: one record is opened, however many are listed."""
    try:
        made_by = source.scene(scene_id).producers
    except PermanentError as error:  # a running service took it back between two questions
        remark(str(error))
        return
    pair = said_of(made_by.supervised, made_by.selfsupervised)
    remark(f"judged, in the best scene: {pair}; `counterpoint status` counts all")


def select(
    budget: Annotated[
        int,
        typer.Option(
            "--budget", min=1, max=MAX_SCENES_ASKED, help="Scenes the labellers can take."
        ),
    ],
    name: Annotated[str | None, typer.Option("--name", help="Name of the selection.")] = None,
    connect: Connect = None,
    state: StateDir = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Store the best distinct scenes under a name, and publish them."""
    if name is not None and not (0 < len(name) <= MAX_NAME and name.isprintable()):
        raise UsageError(f"--name must have 1 to {MAX_NAME} printing characters, got {name!r}")
    source = reader(config, connect=connect, state=state, database=database)
    selection = source.select(budget=budget, name=name)
    if json:
        for row in selection.scenes:
            json_line({"selection": selection.name} | row.model_dump(mode="json"))
        return
    ranking = source.top(selection.last_rank)
    name_of = short_names(ranking)
    table(
        f"selection {selection.name!r}: {len(selection.scenes)} of at most "
        f"{counted(budget, 'scene')}",
        ("rank", "score", "scene (begins, UTC)", "why"),
        (
            (s.rank, s.score, name_of.get(s.scene_id, s.scene_id), first_of(s.reasons))
            for s in selection.scenes
        ),
    )
    passed = left_out(ranking, selection)
    if passed.twins:
        remark(f"left out: {counted(passed.twins, 'scene')} right beside a better one of the log")
    if passed.without:
        remark(f"left out: {counted(passed.without, 'scene')} in which nothing contradicts")
    remark("ids, for a labelling tool: --json, or the selection as it was published")


def show(
    scene: Annotated[
        str,
        typer.Argument(help="Its rank, its name as `counterpoint top` prints it, or its scene_id."),
    ],
    out: Annotated[Path, typer.Option("--out", help="PNG file to write.")],
    on_image: Annotated[
        bool, typer.Option("--on-image", help="The points on the car's camera image instead.")
    ] = False,
    bucket: Annotated[
        str | None, typer.Option("--bucket", help="Log bucket, for the camera image.")
    ] = None,
    connect: Connect = None,
    state: StateDir = None,
    artifacts: Artifacts = None,
    database: Database = None,
    config: Config = None,
    force: Force = False,
) -> None:
    """Draw a scene from above in the paper's four colours, with its instances."""
    from service.pictures.scene import draw_scene

    need_writable(out, option="--out", force=force, endings=(".png",))
    source = reader(config, connect=connect, state=state, artifacts=artifacts, database=database)
    scene_id = _scene_id(source, scene)
    score, overlay = source.scene(scene_id), overlay_of(source, scene_id)
    if on_image:
        from service.pictures.strongest_frame import draw_on_camera

        picture = draw_on_camera(score, overlay, settings_for(config, bucket=bucket))
    else:
        picture = draw_scene(score, overlay)
    save_picture(picture, out, option="--out", force=force)
    remark(f"{out}: {score.scene_id}, score {score.score:.3f}")
    say_judged([score])


def _scene_id(source: Reader, said: str) -> str:
    """Find the scene that a person names: by rank, short name or id.

    Raises:
        NothingFoundError: If there is none.
        UsageError: If several have the name.
    """
    if said.isdecimal():
        rank = int(said) if len(said) < len(str(MOST)) else 0
        rows = source.top(rank) if rank else []
        if not rows or len(rows) < rank:
            raise NothingFoundError(f"no scene of rank {said}; `counterpoint top` lists them")
        return rows[-1].scene_id
    if is_short_name(said):
        return named(said, source.top()).scene_id
    return said


def status(
    connect: Connect = None,
    state: StateDir = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Say how far everything is: logs, shards, scenes, rates, what is damaged, what is parked."""
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
    """Choose where to read: `--state` or `--database` reads there, `--connect` asks the service.

    Without any, the service that the settings name is asked if they name one, else database or
    folder are read.

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

    return ControlClient(settings.connect.split(","), root=settings.root)


def _watched(event: SceneEvent) -> dict[str, Any]:
    """Flatten an event: its number and digest beside the fields of the record."""
    score = event.score
    if score is None:
        return {"seq": event.seq, "withdrawn": True, "scene_id": event.scene_id}
    about = {"seq": event.seq, "withdrawn": False, "sha256": event.sha256}
    return about | score.model_dump(mode="json")
