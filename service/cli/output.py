"""Where results and remarks go: JSON lines and tables to stdout, everything else to stderr.

Nothing else in the package prints. What others wrote, such as names of vehicles and reasons, is
made `visible` here: it can neither steer the terminal nor be taken for markup.
"""

import json
import shutil
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from shutil import get_terminal_size
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
"""Characters of a table that goes into a pipe or a file, if COLUMNS does not say another width."""

_LEAST: Final = 12
"""Characters of a cell that is not broken for a narrow table."""

_COPIED: Final = ("scene", "log", "name")
"""How columns begin that are there to be copied: they are never broken."""

LINE_EVERY_S: Final = 30.0

remarks = Console(stderr=True, highlight=False, emoji=False)
log = structlog.get_logger(__name__)
results = Console(
    highlight=False,
    emoji=False,
    width=None if sys.stdout.isatty() else get_terminal_size((WIDE, 25)).columns,
)


def json_line(row: BaseModel | Mapping[str, Any]) -> None:
    """Write one result as one JSON line to stdout, at once, so that a pipe sees it live."""
    data = row.model_dump(mode="json") if isinstance(row, BaseModel) else row
    sys.stdout.write(json.dumps(data) + "\n")
    sys.stdout.flush()


def result_line(text: str) -> None:
    """Write one result as one line to stdout, for a person."""
    results.print(visible(text), markup=False, soft_wrap=True)


def page(text: str) -> None:
    """Write a page of our own to stdout, as it is."""
    sys.stdout.write(text)


def usage(text: str) -> None:
    """Write a help of our own to stderr, as it is, for who asked for nothing."""
    sys.stderr.write(text.rstrip() + "\n")


_as_events = Event()


def remark_as_events(on: bool) -> None:
    """Choose who reads stderr: a person, or a machine that wants every line to be an event."""
    (_as_events.set if on else _as_events.clear)()


def remark(text: str, *, level: Literal["info", "warning", "error"] = "info") -> None:
    """Say something to the person at the terminal, or to the machine that reads the log."""
    if _as_events.is_set():
        getattr(log, level)(text)
    else:
        remarks.print(visible(text), markup=False, soft_wrap=True)


def command() -> str:
    """How this command is typed: as it was, where a shell does not find it by its name."""
    typed = Path(sys.argv[0])
    unknown = typed.name == COMMAND and shutil.which(COMMAND) is None
    return str(typed) if unknown else COMMAND


def counted(number: int, what: str) -> str:
    """Say how many, with an s where they are not one."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def table(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Print a table of results; numbers to the right."""
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


def _is_copied(column: str) -> bool:
    return column.split(" ")[0] in _COPIED


def _longest(rows: Sequence[Sequence[str]], index: int) -> int:
    """Width of the longest cell of a column."""
    return max((len(row[index]) for row in rows), default=0)


def _natural_width(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """Width at which nothing is broken."""
    widths = (max(len(column), _longest(rows, index)) for index, column in enumerate(columns))
    return 1 + 3 * len(columns) + sum(widths)


def _folded_width(column: str, rows: Sequence[Sequence[str]], index: int) -> int:
    """Width of a column whose header is broken at its spaces: room for the long cells of others."""
    return max(_longest(rows, index), *(len(word) for word in column.split(" ")))


def _least_width(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """Width below which names would be cut and numbers broken: a file can be as wide as that."""
    width = 1 + 3 * len(columns)
    for index, column in enumerate(columns):
        longest = _longest(rows, index)
        whole = longest if _is_copied(column) else min(longest, _LEAST)
        width += max(whole, *(len(word) for word in column.split(" ")))
    return width


class _Bar(Progress):
    """Draws bars whose descriptions may name what others named."""

    def add_task(self, description: str, *arguments: Any, **fields: Any) -> TaskID:
        """Add a task, its description made visible."""
        return super().add_task(visible(description), *arguments, **fields)

    def update(self, task_id: TaskID, **fields: Any) -> None:
        """Take in how far a task is."""
        if isinstance(fields.get("description"), str):
            fields["description"] = visible(fields["description"])
        super().update(task_id, **fields)


class _Lines(Progress):
    """Says how far the work is every half a minute, where no bar can be drawn."""

    def __init__(self) -> None:
        super().__init__(disable=True)
        self._said_s = monotonic()

    def update(self, task_id: TaskID, **fields: Any) -> None:
        """Take in how far a task is."""
        super().update(task_id, **fields)
        if _as_events.is_set() or monotonic() - self._said_s < LINE_EVERY_S:
            return
        self._said_s = monotonic()
        task = self.tasks[self.task_ids.index(task_id)]
        remark(f"{task.description}{_how_far(task)}")


def _how_far(task: Task) -> str:
    """What is done of a task, as the end of a line; nothing where nothing can be counted yet."""
    if task.total is not None:
        return f": {task.completed:g} of {task.total:g}"
    return f": {task.completed:g}" if task.completed else ""


def progress() -> Progress:
    """Make a progress bar on stderr; a line now and then where stderr is no terminal."""
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
