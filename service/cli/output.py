"""Output of the command line: JSON lines and tables to stdout, everything else to stderr.

Nothing else in the package prints. Foreign text, such as names of vehicles and reasons, is passed
through `visible` here: it can neither steer the terminal nor be taken for markup.
"""

import json
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from shutil import get_terminal_size
from textwrap import wrap
from threading import Event
from time import monotonic
from typing import Any, Final, Literal

import structlog
from pydantic import BaseModel
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    Task,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from schemas.visible import visible

COMMAND: Final = "counterpoint"
WIDE: Final = 120
"""Width of a table in a pipe or a file, characters, if COLUMNS gives no other."""

_LEAST: Final = 12
"""Width up to which a cell is never broken for a narrow table, characters."""

_COPIED: Final = ("scene", "log", "name")
"""Beginnings of the names of columns that users copy from; their cells are never broken."""

_INDENT: Final = "      "
"""Indent of a sentence below its row."""

LINE_EVERY_S: Final = 30.0

remarks = Console(stderr=True, highlight=False, emoji=False)
log = structlog.get_logger(__name__)
results = Console(
    highlight=False,
    emoji=False,
    width=None if sys.stdout.isatty() else get_terminal_size((WIDE, 25)).columns,
)


def json_line(row: BaseModel | Mapping[str, Any]) -> None:
    """Write one result as one JSON line to stdout, flushed, so that a pipe sees it live."""
    data = row.model_dump(mode="json") if isinstance(row, BaseModel) else row
    sys.stdout.write(json.dumps(data) + "\n")
    sys.stdout.flush()


def result_line(text: str) -> None:
    """Write one result as one line of plain text to stdout."""
    results.print(visible(text), markup=False, soft_wrap=True)


def page(text: str) -> None:
    """Write a page of our own to stdout, unescaped."""
    sys.stdout.write(text)


def usage(text: str) -> None:
    """Write a help text of our own to stderr, unescaped, after a call without a verb."""
    sys.stderr.write(text.rstrip() + "\n")


_as_events = Event()


def remark_as_events(on: bool) -> None:
    """Choose the form of remarks on stderr: plain text, or log events for machines."""
    (_as_events.set if on else _as_events.clear)()


def remark(text: str, *, level: Literal["info", "warning", "error"] = "info") -> None:
    """Write a remark to the terminal, or as an event to the log."""
    if _as_events.is_set():
        getattr(log, level)(text)
    else:
        remarks.print(visible(text), markup=False, soft_wrap=True)


def command() -> str:
    """Return the command as the user can type it: its name, else its path."""
    typed = Path(sys.argv[0])
    unknown = typed.name == COMMAND and shutil.which(COMMAND) is None
    return str(typed) if unknown else COMMAND


def counted(number: int, what: str) -> str:
    """Format a count with its noun, which gets an s unless the count is one."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def table(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Print a table of results; numbers are right-aligned."""
    heading = Text(visible(title), style="table.title")
    out = Table(title=heading, title_justify="left", header_style="bold")
    materialised = [[_cell(value) for value in row] for row in rows]
    names = tuple(visible(column) for column in columns)
    crowded = _natural_width(names, materialised) > results.width
    for index, column in enumerate(names):
        numeric = bool(materialised) and all(
            row[index].replace(".", "").replace("-", "").replace(",", "").isdigit()
            for row in materialised
            if row[index]
        )
        out.add_column(
            Text(column),
            justify="right" if numeric else "left",
            overflow="fold",
            no_wrap=_is_copied(column),
            max_width=_folded_width(column, materialised, index) if crowded else None,
        )
    for row in materialised:
        out.add_row(*map(Text, row))  # as text: a name may look like markup
    if results.is_terminal:
        results.print(out)
        return
    piped = Console(
        file=results.file,
        highlight=False,
        width=max(results.width, _least_width(list(names), materialised)),
    )
    piped.print(out)


def listing(
    title: str, columns: Sequence[str], rows: Iterable[tuple[Sequence[object], str]]
) -> None:
    """Print rows of short cells, each with a sentence below it, which has the whole width.

    On a terminal the sentence is wrapped; elsewhere it stays one line, whatever its length.

    Args:
        title: Printed above.
        columns: Names of the cells.
        rows: Cells of each row, and its sentence; an empty one prints nothing.
    """
    shown = [([_cell(value) for value in cells], visible(text)) for cells, text in rows]
    widths = [
        max(len(name), *(len(cells[index]) for cells, _ in shown)) if shown else len(name)
        for index, name in enumerate(columns)
    ]

    def line(cells: Sequence[str]) -> str:
        padded = (cell.ljust(width) for cell, width in zip(cells, widths, strict=True))
        return "  ".join(padded).rstrip()

    results.print(Text(visible(title), style="table.title"), soft_wrap=True)
    results.print(Text(line(columns), style="bold"), soft_wrap=True)
    for cells, text in shown:
        results.print(Text(line(cells)), soft_wrap=True)
        width = max(results.width, 2 * len(_INDENT)) if results.is_terminal else len(text) + 80
        for each in wrap(text, width, initial_indent=_INDENT, subsequent_indent=_INDENT):
            results.print(Text(each), soft_wrap=True)


def _is_copied(column: str) -> bool:
    return column.split(" ")[0] in _COPIED


def _longest(rows: Sequence[Sequence[str]], index: int) -> int:
    """Return the width of the longest cell of a column."""
    return max((len(row[index]) for row in rows), default=0)


def _natural_width(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """Return the width at which nothing is broken."""
    widths = (max(len(column), _longest(rows, index)) for index, column in enumerate(columns))
    return 1 + 3 * len(columns) + sum(widths)


def _folded_width(column: str, rows: Sequence[Sequence[str]], index: int) -> int:
    """Return the width of a column whose header is broken at spaces, to make room for others."""
    return max(_longest(rows, index), *(len(word) for word in column.split(" ")))


def _least_width(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """Return the least width that cuts no name and breaks no number; a file can be that wide."""
    width = 1 + 3 * len(columns)
    for index, column in enumerate(columns):
        longest = _longest(rows, index)
        whole = longest if _is_copied(column) else min(longest, _LEAST)
        width += max(whole, *(len(word) for word in column.split(" ")))
    return width


class _Bar(Progress):
    """Progress bar that escapes its descriptions, which may contain foreign names."""

    def add_task(self, description: str, *arguments: Any, **fields: Any) -> TaskID:
        """Add a task with its description escaped."""
        return super().add_task(visible(description), *arguments, **fields)

    def update(self, task_id: TaskID, **fields: Any) -> None:
        """Update the progress of a task."""
        if isinstance(fields.get("description"), str):
            fields["description"] = visible(fields["description"])
        super().update(task_id, **fields)


class _Lines(Progress):
    """Progress as a line every 30 s, where no bar can be drawn."""

    def __init__(self) -> None:
        super().__init__(disable=True)
        self._said_s = monotonic()

    def update(self, task_id: TaskID, **fields: Any) -> None:
        """Update the progress of a task."""
        super().update(task_id, **fields)
        if _as_events.is_set() or monotonic() - self._said_s < LINE_EVERY_S:
            return
        self._said_s = monotonic()
        task = self.tasks[self.task_ids.index(task_id)]
        remark(f"{task.description}{_how_far(task)}")


def _how_far(task: Task) -> str:
    """Return the progress of a task as the end of a line; empty if it cannot be counted yet."""
    if task.total is not None:
        return f": {task.completed:g} of {task.total:g}"
    return f": {task.completed:g}" if task.completed else ""


def progress() -> Progress:
    """Make a progress bar on stderr, or lines at intervals where stderr is no terminal."""
    if not remarks.is_terminal or _as_events.is_set():
        return _Lines()
    return _Bar(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=remarks,
        transient=True,
    )


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.3f}" if isinstance(value, float) else visible(str(value))
