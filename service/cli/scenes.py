"""Verbs on what was found: `watch`, `top`, `select`, `show`, `status`."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from service.cli.output import json_line, remark, results, table
from service.cli.report import say_ranking, say_what_was_found
from service.config import Settings, load_settings
from service.errors import NothingFoundError, UsageError
from service.merging import SceneEvent
from service.reading import Reader, StateReader, choose_endpoint

Connect = Annotated[str | None, typer.Option("--connect", help="tcp/HOST:PORT of the router.")]
StateDir = Annotated[
    Path | None, typer.Option("--state", help="Folder of a run; no daemon is needed then.")
]
Artifacts = Annotated[str | None, typer.Option("--artifacts", help="URL of the overlays.")]
Json = Annotated[bool, typer.Option("--json", help="JSON lines on stdout.")]


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(epilog="counterpoint watch --connect tcp/127.0.0.1:7447 --json")(watch)
    app.command(epilog="counterpoint top -n 20 --state counterpoint-state")(top)
    app.command(epilog="counterpoint select --budget 50 --name week-47")(select)
    app.command(
        epilog="counterpoint show car-7/2026-11-20/drive/lidar/1750000000000000000 --out a.png"
    )(show)
    app.command(epilog="counterpoint status --state counterpoint-state")(status)


def watch(
    connect: Connect = None,
    history: Annotated[
        int | None, typer.Option("--history", min=0, help="Newest scenes first; all by default.")
    ] = None,
    json: Json = False,
) -> None:
    """Subscribe to scored scenes: the history first, then each as it is committed."""
    from schemas.process import stop_on_signals
    from service.client import watch_scenes

    settings = load_settings(connect=connect)
    endpoint = choose_endpoint(settings)
    remark(f"watching {endpoint}; end with Ctrl-C")
    with stop_on_signals() as stop:
        for event in watch_scenes(
            endpoint.split(","), root=settings.root, history=history, stop=stop
        ):
            if json:
                json_line(_watched(event))
            elif (score := event.score) is None:
                results.print(f"[{event.seq}] withdrawn  {event.scene_id}", markup=False)
            else:
                reason = score.reasons[0] if score.reasons else score.state.value
                results.print(
                    f"[{event.seq}] {score.score:.3f}  {score.scene_id}  {reason}", markup=False
                )


def top(
    n: Annotated[int | None, typer.Option("-n", min=1, help="Rows; all by default.")] = None,
    connect: Connect = None,
    state: StateDir = None,
    json: Json = False,
) -> None:
    """List every current scene, the most contradicting first."""
    rows = reader(connect=connect, state=state).top()[:n]
    if json:
        for row in rows:
            json_line(row)
        return
    say_ranking(rows)


def select(
    budget: Annotated[int, typer.Option("--budget", min=1, help="Scenes the labellers can take.")],
    name: Annotated[str | None, typer.Option("--name", help="Name of the selection.")] = None,
    connect: Connect = None,
    state: StateDir = None,
    json: Json = False,
) -> None:
    """Store the best distinct scenes under a name, and publish them."""
    selection = reader(connect=connect, state=state).select(budget=budget, name=name)
    if json:
        for row in selection.scenes:
            json_line({"selection": selection.name} | row.model_dump(mode="json"))
        return
    table(
        f"selection {selection.name!r}: {len(selection.scenes)} of at most {budget} scenes",
        ("rank", "score", "scene", "why"),
        ((s.rank, s.score, s.scene_id, "; ".join(s.reasons[:2])) for s in selection.scenes),
    )


def show(
    scene_id: Annotated[str, typer.Argument(help="As `counterpoint top` prints it.")],
    out: Annotated[Path, typer.Option("--out", help="PNG file to write.")],
    camera: Annotated[
        bool, typer.Option("--camera", help="The points on the camera image instead.")
    ] = False,
    bucket: Annotated[
        str | None, typer.Option("--bucket", help="Log bucket, for the camera image.")
    ] = None,
    connect: Connect = None,
    state: StateDir = None,
    artifacts: Artifacts = None,
) -> None:
    """Draw a scene from above in the paper's four colours, with its instances."""
    from schemas.overlay import decode_overlay
    from service.picture import draw_scene

    source = reader(connect=connect, state=state, artifacts=artifacts)
    score, overlay = source.scene(scene_id), decode_overlay(source.overlay(scene_id))
    if out.suffix.lower() != ".png":
        raise UsageError(f"--out must name a .png file, got {out}")
    if not out.absolute().parent.is_dir():
        raise UsageError(f"no such folder: {out.absolute().parent}")
    if camera:
        from service.camera import draw_on_camera

        picture = draw_on_camera(score, overlay, load_settings(bucket=bucket))
    else:
        picture = draw_scene(score, overlay)
    picture.save(out)
    remark(f"{out}: {score.scene_id}, score {score.score:.3f}")


def status(connect: Connect = None, state: StateDir = None, json: Json = False) -> None:
    """Say how far everything is: logs, shards, scenes, rates, what is damaged, what is parked."""
    found = reader(connect=connect, state=state).status()
    if json:
        json_line(found)
        return
    say_what_was_found(found)


def reader(*, connect: str | None, state: Path | None, artifacts: str | None = None) -> Reader:
    """Choose where to read: `--state` reads the folder, `--connect` asks the service.

    Without either, the service of the default state folder is asked when one runs, else the folder
    is read.

    Raises:
        UsageError: If both are given.
        NothingFoundError: If there is neither a service nor a state folder.
    """
    if connect is not None and state is not None:
        raise UsageError("give --connect or --state, not both")
    settings = load_settings(connect=connect, state=state, artifacts=artifacts)
    if state is None and settings.connect:
        return _remote(settings)
    if not settings.state.is_dir():
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
