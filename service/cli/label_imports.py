"""Verb `import-labels`: finished labels of an export become truth, and judge the contradictions."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Annotated

import typer

from schemas.bounds import MAX_NAME
from schemas.errors import PermanentError
from schemas.overlay import Overlay
from schemas.score import SceneScore
from schemas.transport.wire import decode
from service.api.reader import Reader, overlay_of
from service.cli.options import Artifacts, Config, Connect, Database, Json, StateToRead
from service.cli.output import counted, json_line, remark
from service.cli.scenes import reader
from service.errors import UsageError
from service.export.classes import MOVING_ATTRIBUTE
from service.export.judging import (
    UNSURE,
    JudgedContradiction,
    counted_verdicts,
    judge,
    verdicts_of,
)
from service.export.label_import import ImportedScene, read_scenes, write_truth
from service.export.labels.forms import ALL_NAMES, form_named
from service.export.labels.labelstudio import NAME as LABEL_STUDIO
from service.export.labels.labelstudio import read_answers
from service.output_files import need_folder


def add_to(app: typer.Typer) -> None:
    """Add the verbs of this file to the command."""
    app.command("import-labels", epilog="counterpoint import-labels week-47 --truth truth")(
        import_labels
    )


def import_labels(
    folder: Annotated[
        Path,
        typer.Argument(help="Folder of an export with finished labels; labelstudio: a JSON file."),
    ],
    truth: Annotated[
        Path | None,
        typer.Option("--truth", help="Folder of truth to write, empty or new; labelstudio: none."),
    ] = None,
    form: Annotated[
        str, typer.Option("--format", help=f"Form of the labels: {', '.join(ALL_NAMES)}.")
    ] = "semantickitti",
    reviewer: Annotated[
        str | None,
        typer.Option(
            "--reviewer",
            help="Also store the judgements as verdicts on tracks, under this name; default: not.",
        ),
    ] = None,
    confirmed: Annotated[
        bool,
        typer.Option(
            "--confirmed",
            help="Scenes that still have the pre-labels are finished, too; default: no verdicts of "
            "them, since they would be the streams' own.",
        ),
    ] = False,
    connect: Connect = None,
    state: StateToRead = None,
    artifacts: Artifacts = None,
    database: Database = None,
    json: Json = False,
    config: Config = None,
) -> None:
    """Return finished labels to their raw points, as truth, and judge each contradiction by them.

    `bench failures --truth` reads the result. Nothing is written if one label file does not fit.
    """
    if reviewer is not None and not 0 < len(reviewer.strip()) <= MAX_NAME:
        raise UsageError(f"--reviewer: give a name of 1 to {MAX_NAME} characters")
    open_source = partial(
        reader, config, connect=connect, state=state, artifacts=artifacts, database=database
    )
    if form == LABEL_STUDIO:
        _import_answers(folder, truth, reviewer, open_source)
        return
    wanted = form_named(form)
    if truth is None:
        raise UsageError("--truth is missing: name the folder of truth to write")
    if truth.is_dir() and any(truth.iterdir()):
        raise UsageError(f"--truth must be an empty folder, or a new one ({truth})")
    source = open_source()
    scenes = list(read_scenes(folder, wanted, partial(_current, source)))
    need_folder(truth, option="--truth")
    frames = write_truth(scenes, truth)
    judged, stored = list[JudgedContradiction](), 0
    for scene in scenes:
        found = _judged(source, scene, json=json)
        judged += found
        if reviewer is not None and found and (confirmed or not scene.is_unchanged):
            stored += _store(source, scene.scene_id, found, reviewer=reviewer)
    unlabelled = sum(scene.unlabelled for scene in scenes)
    without = f"; {counted(unlabelled, 'frame')} without labels" if unlabelled else ""
    remark(f"{truth}: {counted(frames, 'frame')} of {counted(len(scenes), 'scene')}{without}")
    if same := sum(frame.is_unchanged for scene in scenes for frame in scene.frames):
        remark(
            f"{same} of {counted(frames, 'frame')} still have the pre-labels of the export: if "
            "they are not finished, these judgements are the streams' own"
        )
        untouched = sum(scene.is_unchanged for scene in scenes)
        if reviewer is not None and untouched and not confirmed:
            remark(
                f"no verdicts of {counted(untouched, 'scene')} in which no label changed: give "
                "--confirmed if the reviewer agrees with all of them"
            )
    told = ", ".join(f"{name} {count}" for name, count in counted_verdicts(judged).items())
    remark(f"{counted(len(judged), 'contradiction')} judged; which stream is wrong: {told or '-'}")
    if unsure := sum(each.verdict == UNSURE for each in judged):
        remark(
            f"{unsure} {UNSURE}: the labels of most of their points say neither static nor moving: "
            f"they have no label, or a cuboid whose attribute {MOVING_ATTRIBUTE} is not set"
        )
    if reviewer is not None:
        remark(f"{counted(stored, 'verdict')} of {reviewer} on tracks that are a reason")


def _import_answers(
    path: Path, truth: Path | None, reviewer: str | None, open_source: Callable[[], Reader]
) -> None:
    """Store the answers of Label Studio as verdicts."""
    if truth is not None:
        raise UsageError("--truth: answers of Label Studio are verdicts, and label no points")
    if reviewer is None:
        raise UsageError("--reviewer is missing: answers of Label Studio are stored as verdicts")
    answers = read_answers(path, reviewer.strip())
    source, stored, lost = open_source(), 0, dict[str, str]()
    for answer in answers:
        try:
            source.judge(answer)
            stored += 1
        except PermanentError as error:
            lost[answer.scene_id] = str(error)
    if not stored:
        why = next(iter(lost.values()), "no task has an answer")
        raise UsageError(f"no answer of this file is a verdict: {why} ({path})")
    for scene_id, why in lost.items():
        remark(f"not stored: {scene_id}: {why}")
    remark(f"{counted(stored, 'verdict')} of {reviewer} from Label Studio")


def _current(source: Reader, scene_id: str) -> tuple[SceneScore, Overlay]:
    return decode(SceneScore, source.record(scene_id)), overlay_of(source, scene_id)


def _judged(source: Reader, scene: ImportedScene, *, json: bool) -> list[JudgedContradiction]:
    """Judge a scene; one that is no longer current has truth, and no judgement."""
    try:
        found = judge(overlay_of(source, scene.scene_id), scene.frames)
    except PermanentError as error:
        remark(f"not judged: {scene.scene_id}: {error}")
        return []
    for each in found:
        if json:
            json_line({"scene_id": scene.scene_id, **asdict(each)})
    return found


def _store(
    source: Reader, scene_id: str, judged: Sequence[JudgedContradiction], *, reviewer: str
) -> int:
    """Store the judgements of a scene that decide, as verdicts; return their number."""
    record = source.record(scene_id)
    requests = verdicts_of(judged, decode(SceneScore, record), sha256(record).hexdigest(), reviewer)
    for request in requests:
        source.judge(request)
    return len(requests)
