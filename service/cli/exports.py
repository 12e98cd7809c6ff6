"""Verb `export`: a selection in the form that a labelling tool opens."""

import tempfile
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import unquote, urlsplit

import typer

from schemas.canonical import sha256
from schemas.transport.bucket import open_bucket
from schemas.transport.wire import encode_scene_score
from service.api.reader import Reader, overlay_of
from service.api.state_reader import StateReader
from service.cli.export_bucket import BucketSink
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
from service.client import ControlClient
from service.curation.audit import ExportedRequest
from service.curation.ranking import RankedScene
from service.curation.selection import Selection
from service.curation.verdicts import MAX_VERDICTS_ASKED, VerdictsRequest
from service.errors import UsageError
from service.export.format import Format
from service.export.formats import FORMATS, format_named
from service.export.running import ExportReport, run_export
from service.export.scene import JudgedTrack, SceneToExport
from service.export.sink import Sink
from service.output_files import need_folder
from service.settings.config import Settings
from service.settings.hidden_passwords import shown
from service.store.state import endpoint_of_running

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
    out: Annotated[
        str, typer.Option("--out", help="Folder or bucket URL to write, new or to be continued.")
    ],
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
    settings = settings_for(config, bucket=bucket, state=state)
    logs = _logs(wanted, settings.bucket)
    with _output(out) as (folder, sink), progress() as bar:
        note_export(source, settings, chosen, form=form, place=out)
        task = bar.add_task(f"exporting {chosen.name}", total=len(chosen.scenes))
        told = _Told(json=json)

        def on_scene(done: int, report: ExportReport) -> None:
            bar.update(task, completed=done)
            told.tell(report)

        report = run_export(
            chosen,
            wanted,
            folder,
            _opener(source, chosen.name, logs),
            sink=sink,
            on_scene=on_scene,
        )
    _say(report, out, wanted)
    if report.missing:
        raise typer.Exit(EX_INCOMPLETE)


def note_export(
    source: Reader, settings: Settings, chosen: Selection, *, form: str, place: str
) -> None:
    """Note an export in the audit log, before anything is written.

    Raises:
        CounterpointError: If it cannot be noted; then nothing is exported.
    """
    asked = ExportedRequest(
        selection=chosen.name, form=form, scenes=len(chosen.scenes), place=shown(place)
    )
    endpoint = endpoint_of_running(settings.state) if isinstance(source, StateReader) else ""
    if endpoint:  # the service on this state is the only writer
        locks = settings.client_locks
        ControlClient(endpoint.split(","), root=settings.root, locks=locks).exported(asked)
    else:
        source.exported(asked)


@contextmanager
def _output(out: str) -> Iterator[tuple[Path, Sink | None]]:
    """Open the output of `--out`: its folder; or a folder to work in, and its bucket."""
    parts = urlsplit(out)
    if parts.scheme in ("", "file") or len(parts.scheme) == 1:  # one letter: a drive
        folder = Path(unquote(parts.path) if parts.scheme == "file" else out)
        need_folder(folder, option="--out")
        yield folder, None
        return
    sink = BucketSink(open_bucket(out))
    with tempfile.TemporaryDirectory(prefix="counterpoint-export-") as folder_name:
        yield Path(folder_name), sink


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


class _Told:
    """Prints each scene once, when it is done."""

    def __init__(self, *, json: bool) -> None:
        self._json = json
        self._seen: set[str] = set()

    def tell(self, report: ExportReport) -> None:
        """Print a line for each scene that came since."""
        for scene_id, written in report.written.items():
            if scene_id in self._seen:
                continue
            if self._json:
                about = {"scene_id": scene_id, "place": written.place, "bytes": written.size}
                json_line({**about, "seconds": round(written.seconds, 3)})
            else:
                size, seconds = written.size / 1e6, written.seconds
                remark(f"{written.place}: {size:.1f} MB in {seconds:.1f} s")
        for scene_id, why in report.missing.items():
            if scene_id not in self._seen:
                remark(f"missing: {scene_id}: {why}")
        self._seen |= report.written.keys() | report.missing.keys()


def _say(report: ExportReport, out: str, wanted: Format) -> None:
    done = counted(len(report.written), "scene")
    kept = f"; {counted(len(report.kept), 'scene')} of an earlier run kept" if report.kept else ""
    missing = f"; {counted(len(report.missing), 'scene')} missing" if report.missing else ""
    what = f"{done} written as {wanted.name}" if wanted.write_scene else f"written as {wanted.name}"
    remark(f"{out}: {what}{kept}{missing}")
