"""Run of an export: scene after scene, each whole or not at all, and resumed where it ended."""

import errno
import os
import shutil
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from schemas.errors import PermanentError, TransientError
from service.curation.ranking import RankedScene
from service.curation.selection import Selection
from service.export.format import Format
from service.export.journal import Journal, open_journal
from service.export.scene import SceneToExport
from service.export.sink import Sink

_FULL: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})

OpenScene = Callable[[int, RankedScene], SceneToExport]
"""Reads the record of a scene of the selection, by its number and row."""


class OutputFullError(TransientError):
    """The disk of the output is full; the same command goes on later."""


@dataclass(frozen=True, slots=True)
class Written:
    """A scene that was written.

    Attributes:
        place: Its path, relative to the folder.
        size: Its bytes.
        seconds: Time it took.
    """

    place: str
    size: int
    seconds: float


@dataclass(slots=True)
class ExportReport:
    """Result of a run.

    Attributes:
        written: Scenes written now, by id.
        kept: Scenes that an earlier run had written.
        missing: Scenes that cannot be exported, by id, and why.
    """

    written: dict[str, Written] = field(default_factory=dict)
    kept: list[str] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)


def run_export(
    selection: Selection,
    wanted: Format,
    folder: Path,
    open_scene: OpenScene,
    *,
    sink: Sink | None = None,
    on_scene: Callable[[int, ExportReport], None] = lambda done, report: None,
) -> ExportReport:
    """Export a selection into a folder, or through one into another output.

    A scene grows under another name and is renamed when it is whole. A scene that an earlier run
    wrote from the same record stays.

    Args:
        selection: The scenes.
        wanted: The format.
        folder: Folder of the output, which exists; with a sink an empty one to work in.
        open_scene: Reads a scene.
        sink: Output that is no folder; None: the folder is the output.
        on_scene: Called with the number of scenes done, and the result so far.

    Raises:
        UsageError: If the folder contains another export or files of something else, or if a
            package that the format needs is missing.
        StateInUseError: If another export into the folder runs.
        OutputFullError: If the disk is full.
    """
    if wanted.check is not None:
        wanted.check()
    report = ExportReport()
    with open_journal(folder, selection, format_name=wanted.name, sink=sink) as journal:
        found: list[SceneToExport] = []
        try:
            for number, row in enumerate(selection.scenes):
                try:
                    scene = open_scene(number, row)
                    _export(scene, wanted, journal, report)
                    scene.release()
                    found.append(scene)
                except PermanentError as error:
                    report.missing[row.scene_id] = str(error)
                on_scene(number + 1, report)
            if wanted.write_all is not None:
                _write_all(selection, found, wanted, journal)
        except OSError as error:
            if error.errno not in _FULL:
                raise
            done = len(report.written) + len(report.kept)
            raise OutputFullError(
                f"the disk is full: {done} of {len(selection.scenes)} scenes are written whole; "
                f"make room, and the same command goes on ({folder})"
            ) from None
    return report


def _export(scene: SceneToExport, wanted: Format, journal: Journal, report: ExportReport) -> None:
    if wanted.write_scene is None:
        return
    scene_id, sha256 = scene.row.scene_id, scene.sha256
    if journal.is_written(scene_id, sha256=sha256):
        report.kept.append(scene_id)
        return
    place, begun = wanted.place_of(scene), time.monotonic()
    growing = journal.growing / Path(place).name
    try:
        wanted.write_scene(scene, growing)
        size = _settled(growing)
        journal.place(growing, place)
    finally:
        _remove(growing)
    seconds = time.monotonic() - begun
    journal.add({"scene_id": scene_id, "sha256": sha256, "place": place, "bytes": size})
    report.written[scene_id] = Written(place, size, seconds)


def _write_all(
    selection: Selection, scenes: list[SceneToExport], wanted: Format, journal: Journal
) -> None:
    if wanted.write_all is None:
        return
    growing = journal.growing / "all"
    growing.mkdir()
    wanted.write_all(selection, scenes, growing)
    for path in sorted(_files_of(growing)):
        _settled(path)
        journal.place(path, path.relative_to(growing).as_posix())


def _files_of(path: Path) -> Iterable[Path]:
    return [path] if path.is_file() else [each for each in path.rglob("*") if each.is_file()]


def _settled(path: Path) -> int:
    """Bring the files of a path to the disk, and return their bytes."""
    size = 0
    for each in _files_of(path):
        with each.open("rb") as file:
            os.fsync(file.fileno())
        size += each.stat().st_size
    return size


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
