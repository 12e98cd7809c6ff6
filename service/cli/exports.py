"""Verb `export`: a selection in the form that a labelling tool opens."""

import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from schemas.canonical import sha256
from schemas.transport.bucket import open_bucket
from schemas.transport.wire import encode_scene_score
from service.api.reader import Reader, overlay_of
from service.cli.options import (
    Artifacts,
    BucketUrl,
    Config,
    Connect,
    Database,
    Json,
    StateToRead,
    settings_for,
)
from service.cli.output import counted, json_line, progress, remark
from service.cli.scenes import reader
from service.curation.ranking import RankedScene
from service.curation.verdicts import MAX_VERDICTS_ASKED, VerdictsRequest
from service.errors import UsageError
from service.export.format import Format
from service.export.formats import FORMATS, format_named
from service.export.running import ExportReport, run_export
from service.export.scene import JudgedTrack, SceneToExport
from service.output_files import need_folder

if TYPE_CHECKING:
    from schemas.excerpt import ExcerptSource

EX_INCOMPLETE = 3
"""Exit code where scenes are missing, as of `run --once` with parked work."""


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command(epilog="counterpoint export week-47 --format mcap --out week-47 --bucket logs")(
        export
    )


def _formats_in_help() -> str:
    lines = ["Format, one of:"]
    for each in FORMATS.values():
        lines.append(each.name)
        lines += textwrap.wrap(each.text, 38, initial_indent="  ", subsequent_indent="  ")
    return "\b\n" + "\n".join(lines)


def export(
    selection: Annotated[str, typer.Argument(help="Name, as `selection list` prints it.")],
    form: Annotated[str, typer.Option("--format", help=_formats_in_help())],
    out: Annotated[Path, typer.Option("--out", help="Folder to write, new or to be continued.")],
    bucket: BucketUrl = None,
    connect: Connect = None,
    state: StateToRead = None,
    artifacts: Artifacts = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Write a stored selection in the form of a labelling tool; resumed where it ended.

    The exit code is 3 if scenes are missing, such as those whose log is gone.
    """
    wanted = format_named(form)
    source = reader(config, connect=connect, state=state, artifacts=artifacts, database=database)
    chosen = source.selection(selection)
    logs = _logs(wanted, settings_for(config, bucket=bucket).bucket)
    need_folder(out, option="--out")
    with progress() as bar:
        task = bar.add_task(f"exporting {chosen.name}", total=len(chosen.scenes))
        report = run_export(
            chosen,
            wanted,
            out,
            _opener(source, chosen.name, logs),
            on_scene=lambda done: bar.update(task, completed=done),
        )
    _say(report, out, wanted, json=json)
    if report.missing:
        raise typer.Exit(EX_INCOMPLETE)


def _logs(wanted: Format, bucket: str) -> "ExcerptSource | None":
    """Open the bucket of the logs, if the format reads them.

    Raises:
        UsageError: If it does, and no bucket is named, or the extra `workers` is not installed.
    """
    if not wanted.reads_logs:
        return None
    if not bucket:
        raise UsageError(
            f"format {wanted.name} reads the logs: name their bucket with --bucket URL"
        )
    try:
        from workers.excerpt.source import BucketExcerpts
    except ModuleNotFoundError as error:
        raise UsageError(
            f"format {wanted.name} reads the logs, and {error.name} is not installed: "
            "install 'counterpoint[workers]'"
        ) from None
    opened = open_bucket(bucket)
    next(iter(opened.list()), None)  # a bucket that cannot be read is refused before any scene
    return BucketExcerpts(opened)


def _opener(
    source: Reader, selection: str, logs: "ExcerptSource | None"
) -> Callable[[int, RankedScene], SceneToExport]:
    def open_scene(number: int, row: RankedScene) -> SceneToExport:
        score = source.scene(row.scene_id)
        return SceneToExport(
            number=number,
            selection=selection,
            row=row,
            score=score,
            sha256=sha256(encode_scene_score(score)),
            verdicts=_verdicts_on(source, row),
            open_overlay=lambda: overlay_of(source, row.scene_id),
            source=logs,
        )

    return open_scene


def _verdicts_on(source: Reader, row: RankedScene) -> tuple[JudgedTrack, ...]:
    """Return the verdicts that count on the record of a scene, latest first."""
    asked = VerdictsRequest(scene_id=row.scene_id, most=MAX_VERDICTS_ASKED)
    return tuple(
        JudgedTrack(
            track_id=each.track_id,
            reviewer=each.reviewer,
            verdict=each.verdict.value,
            cause=each.cause,
            note=each.note,
        )
        for each in source.verdicts(asked).rows
        if each.record == "current"
    )


def _say(report: ExportReport, out: Path, wanted: Format, *, json: bool) -> None:
    for scene_id, written in report.written.items():
        if json:
            about = {"scene_id": scene_id, "place": written.place, "bytes": written.size}
            json_line({**about, "seconds": round(written.seconds, 3)})
        else:
            size, seconds = written.size / 1e6, written.seconds
            remark(f"{written.place}: {size:.1f} MB in {seconds:.1f} s")
    for scene_id, why in report.missing.items():
        remark(f"missing: {scene_id}: {why}")
    done = counted(len(report.written), "scene")
    kept = f"; {counted(len(report.kept), 'scene')} of an earlier run kept" if report.kept else ""
    missing = f"; {counted(len(report.missing), 'scene')} missing" if report.missing else ""
    what = f"{done} written as {wanted.name}" if wanted.write_scene else f"written as {wanted.name}"
    remark(f"{out}: {what}{kept}{missing}")
