"""Verb `convert`: published data sets become logs in a bucket, and truth in a folder."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from service.cli.options import Json
from service.cli.output import counted, json_line, progress, remark
from service.errors import UsageError

Dataset = Literal[
    "semantickitti", "kitti-raw", "kitti360", "pandaset", "argoverse2", "nuscenes", "once"
]


def add_to(app: typer.Typer) -> None:
    """Add the verb of this file to the command."""
    app.command(epilog="counterpoint convert pandaset ~/pandaset --to logs --truth truth")(convert)


def convert(
    dataset: Annotated[Dataset, typer.Argument(help="The data set.")],
    source: Annotated[Path, typer.Argument(help="Its folder, in the layout it is published in.")],
    to: Annotated[str, typer.Option("--to", help="Folder or bucket URL for the logs.")],
    truth: Annotated[Path, typer.Option("--truth", help="Folder for the truth.")],
    only: Annotated[
        list[str] | None,
        typer.Option("--only", help="Name of a log to convert; repeatable. Default: all."),
    ] = None,
    labels: Annotated[
        Path | None,
        typer.Option("--labels", help="Also write the classes of points as DIR/x/y/NNNNNN.label."),
    ] = None,
    cameras: Annotated[
        Literal["front", "none"], typer.Option("--cameras", help="Images that are written.")
    ] = "front",
    boxes: Annotated[
        Literal["interpolated", "keyframes"],
        typer.Option("--boxes", help="nuScenes: boxes of the sweeps between its keyframes."),
    ] = "interpolated",
    json: Json = False,
    force: Annotated[bool, typer.Option("--force", help="Replace logs that are there.")] = False,
) -> None:
    """Convert a published data set to MCAP logs, and its labels to truth.

    A killed conversion goes on with the log at which it was killed. The licence of the data set
    stays with the logs and the truth.
    """
    from workers.lab.datasets.conversion.convert import convert as convert_logs
    from workers.lab.datasets.published.catalogue import find_layout, open_logs
    from workers.lab.datasets.published.options import ReadOptions

    layout = find_layout(dataset)
    options = ReadOptions(cameras == "front", boxes == "interpolated")
    logs = open_logs(layout, source.expanduser(), options)
    if only:
        named = {log.name: log for log in logs}
        unknown = next((name for name in only if name not in named), None)
        if unknown is not None:
            raise UsageError(f"--only: no log {unknown!r}; there are {', '.join(sorted(named))}")
        logs = [named[name] for name in dict.fromkeys(only)]
    remark(layout.terms)
    written = frames = there = 0
    notes: dict[str, None] = {}
    with progress() as bar:
        task = bar.add_task("converting", total=sum(log.length for log in logs))
        done = 0

        def on_frame() -> None:
            nonlocal done
            done += 1
            bar.update(task, completed=done)

        for log in convert_logs(
            layout,
            logs,
            to=to,
            truth=truth,
            labels=labels,
            force=force,
            on_frame=on_frame,
        ):
            written += log.outcome == "written"
            there += log.outcome != "written"
            frames += log.frames if log.outcome == "written" else 0
            notes.update(dict.fromkeys(log.notes))
            if json:
                row: dict[str, Any] = {
                    "log": log.log,
                    "outcome": log.outcome,
                    "frames": log.frames,
                    "notes": list(log.notes),
                    "licence": layout.licence,
                    "attribution": layout.attribution,
                }
                json_line(row)
    for note in notes:
        remark(note)
    kept = f"; {counted(there, 'log')} of an earlier run kept" if there else ""
    remark(f"{counted(written, 'log')}, {counted(frames, 'frame')} in {to}, truth in {truth}{kept}")
