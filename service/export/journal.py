"""Journal of an export: the selection and format of a folder, and the scenes written so far.

The journal is a file of JSON lines. Its first line names what the folder is for, and each further
one is appended after a scene has its final name. A last line that a kill cut short is ignored: that
scene is written again. For an output that is no folder, the folder is a working folder: each scene
is sent when it is whole and then removed, and the journal is sent after it.
"""

import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from service.curation.selection import Selection
from service.errors import StateInUseError, UsageError
from service.export.sink import Sink

NAME: Final = "counterpoint-export.jsonl"
"""Name of the journal in the folder of an export."""

_GROWING: Final = ".counterpoint-export.part"
_GENERATOR: Final = "counterpoint"


@dataclass(slots=True)
class Journal:
    """The state of an export's folder.

    Attributes:
        folder: The folder.
        written: Of each scene written whole: its line of the journal, by scene id.
        sink: Output that is no folder; None: the folder is the output.
    """

    folder: Path
    written: dict[str, dict[str, Any]] = field(default_factory=dict)
    sink: Sink | None = None

    @property
    def growing(self) -> Path:
        """Folder in which scenes grow before they get their final name; on the same disk."""
        return self.folder / _GROWING

    def is_written(self, scene_id: str, *, sha256: str) -> bool:
        """Return True if a scene was written from this record, and is still there."""
        line = self.written.get(scene_id)
        if line is None or str(line["sha256"]) != sha256:
            return False
        if self.sink is not None:
            return self.sink.has(str(line["place"]))
        return (self.folder / str(line["place"])).exists()

    def add(self, line: dict[str, Any]) -> None:
        """Append the line of a scene that has its final name."""
        with (self.folder / NAME).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
            file.flush()
            os.fsync(file.fileno())
        self.send_journal()
        self.written[line["scene_id"]] = line

    def place(self, grown: Path, name: str) -> None:
        """Move what has grown to its final place, and replace what is there."""
        if self.sink is not None:
            self.sink.send(grown, name)
            return
        final = self.folder / name
        final.parent.mkdir(parents=True, exist_ok=True)
        if final.is_dir() and not final.is_symlink():
            shutil.rmtree(final)
        grown.replace(final)

    def send_journal(self) -> None:
        """Bring the journal to an output that is no folder."""
        if self.sink is not None:
            self.sink.write_journal(NAME, (self.folder / NAME).read_bytes())


@contextmanager
def open_journal(
    folder: Path, selection: Selection, *, format_name: str, sink: Sink | None = None
) -> Iterator[Journal]:
    """Open the folder of an export, new or to be continued; one process at a time.

    Args:
        folder: The folder, which exists; with a sink an empty one to work in.
        selection: The selection.
        format_name: Name of the format.
        sink: Output that is no folder; None: the folder is the output.

    Raises:
        UsageError: If the folder contains another export, or files of something else.
        StateInUseError: If another export into it runs.
    """
    about = {
        "generator": _GENERATOR,
        "format": format_name,
        "selection": selection.name,
        "scenes": len(selection.scenes),
        "digest": _digest(selection),
    }
    path, where = folder / NAME, str(folder) if sink is None else sink.url
    if sink is not None and (sent := sink.read_journal(NAME)) is not None:
        path.write_bytes(sent)
    if not path.exists() and not _is_empty(folder, sink):
        raise UsageError(
            f"--out has files that no export wrote: name an empty folder, or a new one ({where})"
        )
    with _locked(folder):
        journal = Journal(folder, sink=sink)
        lines = _lines_of(path)
        if lines:
            _need_same(lines[0], about, where)
            journal.written = {each["scene_id"]: each for each in lines[1:]}
        _rewrite(path, [about, *journal.written.values()])
        journal.send_journal()
        shutil.rmtree(journal.growing, ignore_errors=True)
        journal.growing.mkdir()
        try:
            yield journal
        finally:
            shutil.rmtree(journal.growing, ignore_errors=True)


def _is_empty(folder: Path, sink: Sink | None) -> bool:
    if sink is not None:
        return sink.is_empty()
    return all(each.name == _GROWING for each in folder.iterdir())


def scenes_of(folder: Path, *, format_names: Sequence[str]) -> list[tuple[str, str]]:
    """List the scenes of an export, in the order they were written.

    Args:
        folder: The folder of the export.
        format_names: Formats that it may have.

    Returns:
        The place and the id of each scene.

    Raises:
        UsageError: If the folder is no export, or one in another format.
    """
    if not folder.is_dir():
        raise UsageError(f"no such folder: {folder}")
    lines = _lines_of(folder / NAME)
    if not lines or lines[0].get("generator") != _GENERATOR:
        raise UsageError(f"this is no folder of an export: it has no {NAME} ({folder})")
    if lines[0].get("format") not in format_names:
        raise UsageError(
            f"this folder is an export as {lines[0].get('format')}, not as "
            f"{' or '.join(format_names)} ({folder})"
        )
    scenes = [(str(each["place"]), str(each["scene_id"])) for each in lines[1:]]
    for place, _ in scenes:
        need_inside(place, what="place", path=folder / NAME)
    return scenes


def need_inside(relative: str, *, what: str, path: Path) -> None:
    """Refuse a path that leads out of its folder: the files of an export come from elsewhere.

    Raises:
        UsageError: If it is absolute, empty, or goes up.
    """
    parts = Path(relative).parts
    if not parts or Path(relative).is_absolute() or ".." in parts or "\0" in relative:
        raise UsageError(f"{what} leads out of its folder: {relative!r} ({path})")


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Lock a folder against other exports; the lock ends with the process, however it ends."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise StateInUseError(f"another export into this folder runs ({folder})") from None
    finally:
        os.close(descriptor)


def _digest(selection: Selection) -> str:
    """Digest the scenes of a selection and their records, so that equal names do not suffice."""
    named = [(row.scene_id, row.sha256) for row in selection.scenes]
    return hashlib.sha256(json.dumps([selection.name, named]).encode()).hexdigest()[:32]


def _lines_of(path: Path) -> list[dict[str, Any]]:
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    except ValueError:
        raise _not_ours(path) from None
    lines: list[dict[str, Any]] = []
    for line in text.splitlines():
        try:
            read = json.loads(line)
        except ValueError:
            break  # cut by a kill: later lines are of scenes that are written again
        if not isinstance(read, dict) or (lines and not {"scene_id", "sha256", "place"} <= {*read}):
            raise _not_ours(path)
        lines.append(read)
    return lines


def _rewrite(path: Path, lines: list[dict[str, Any]]) -> None:
    """Write a journal whole: a line that was cut short must not precede those that follow."""
    grown = path.with_name(f".{path.name}.part")
    grown.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")
    grown.replace(path)


def _need_same(found: dict[str, Any], about: dict[str, Any], folder: str) -> None:
    if found.get("generator") != _GENERATOR:
        raise _not_ours(f"{folder}/{NAME}")
    if found == about:
        return
    if (found.get("format"), found.get("selection")) == (about["format"], about["selection"]):
        raise UsageError(
            f"--out contains the export of another selection of the name {about['selection']!r}, "
            f"of another state or made again: name another folder ({folder})"
        )
    raise UsageError(
        f"--out contains the export of selection {found.get('selection')!r} as "
        f"{found.get('format')}: name another folder ({folder})"
    )


def _not_ours(path: Path | str) -> UsageError:
    return UsageError(f"this is no journal of an export: name another folder ({path})")
