"""Exports in the background of a page: one process at a time, each resumed by a second start.

A job runs the command `counterpoint export`, so that a page keeps its memory, a stopped page stops
nothing halfway, and a person can run the very same command.
"""

import json
import shlex
import subprocess
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from hashlib import sha256
from typing import Any, Final

from schemas.visible import visible
from service.errors import NothingFoundError, UsageError
from service.export.formats import format_named

MOST_WAITING: Final = 20
"""Jobs that wait at a time; each may take an hour."""

MOST_KEPT: Final = 100
"""Ended jobs that are listed."""

INCOMPLETE: Final = 3
"""Exit code of the command where scenes are missing."""

_END_S: Final = 8.0
"""Time for a stopped process to end, seconds."""

_NAME_CHARACTERS: Final = 80
"""Characters of a selection's name in the name of its folder."""


NO_PLACE: Final = (
    "this page has no folder for exports: start it with --exports DIR or URL, or run the command"
)


class JobState(StrEnum):
    """State of a job."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    INCOMPLETE = "incomplete"
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class ExportJob:
    """Snapshot of one export.

    Attributes:
        number: Its number, 1 first.
        selection: Name of the selection.
        form: Name of the format.
        out: Folder or URL that it writes.
        command: The command that does the same, for a shell.
        state: Its state.
        done: Scenes written so far.
        scenes: Scenes of the selection.
        text: Last line that the process printed, such as its result or what failed.
    """

    number: int
    selection: str
    form: str
    out: str
    command: str
    scenes: int
    state: JobState = JobState.WAITING
    done: int = 0
    text: str = ""

    @property
    def is_open(self) -> bool:
        """True while it waits or runs."""
        return self.state in (JobState.WAITING, JobState.RUNNING)


class ExportJobs:
    """Runs exports one after another.

    Safe to use from several threads.
    """

    def __init__(
        self,
        root: str,
        *,
        program: tuple[str, ...],
        options: Mapping[str, str],
        hidden: Mapping[str, str] | None = None,
    ) -> None:
        """Keep how the command is run; nothing is started yet.

        Args:
            root: Folder or URL below which every export has its folder.
            program: Program with its first arguments, before `export`.
            options: Options of the command by name, such as `state`.
            hidden: Further options that are never shown, such as a URL with a password.
        """
        self._root, self._program = root.rstrip("/"), program
        self._options, self._hidden = dict(options), dict(hidden or {})
        self._jobs: dict[int, ExportJob] = {}
        self._waiting: deque[tuple[int, list[str]]] = deque()
        self._lock, self._closed = threading.Lock(), False
        self._running: tuple[int, subprocess.Popen[str]] | None = None
        self._thread: threading.Thread | None = None

    def command(self, selection: str, form: str, *, bucket: str = "") -> str:
        """Return the command that exports a selection, for a shell."""
        arguments = self._arguments(selection, form, bucket=bucket)
        return shlex.join(["counterpoint", "export", *arguments])

    def place(self, selection: str, form: str) -> str:
        """Return the folder or URL of an export."""
        return f"{self._root}/{folder_name(selection)}-{form}"

    def start(self, selection: str, form: str, *, scenes: int, bucket: str = "") -> ExportJob:
        """Start an export, or return the one that writes the same already.

        Args:
            selection: Name of the selection.
            form: Name of the format.
            scenes: Scenes of the selection.
            bucket: URL of the logs; empty: none.

        Raises:
            UsageError: If there is no such format, it reads logs and no bucket is known, or too
                many jobs wait.
        """
        wanted = format_named(form)
        if wanted.check is not None:
            wanted.check()
        if wanted.reads_logs and not bucket:
            raise UsageError(f"format {form} reads the logs, and their bucket is not known")
        arguments = self._arguments(selection, form, bucket=bucket)
        hidden = [part for name, value in self._hidden.items() for part in (f"--{name}", value)]
        with self._lock:
            out = self.place(selection, form)
            same = [each for each in self._jobs.values() if each.is_open and each.out == out]
            if same:
                return same[0]
            if len(self._waiting) >= MOST_WAITING:
                raise UsageError(f"{MOST_WAITING} exports wait already: stop one, or try later")
            number = max(self._jobs, default=0) + 1
            job = ExportJob(
                number, selection, form, out, self.command(selection, form, bucket=bucket), scenes
            )
            self._jobs[number] = job
            self._waiting.append(
                (number, [*self._program, "export", "--json", *hidden, *arguments])
            )
            self._forget()
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="exports", daemon=True)
                self._thread.start()
            return job

    def jobs(self, selection: str | None = None) -> list[ExportJob]:
        """List the jobs, the latest first; those of one selection, or all."""
        with self._lock:
            found = list(self._jobs.values())
        return [each for each in reversed(found) if selection in (None, each.selection)]

    def stop(self, number: int) -> None:
        """Stop a job; whole scenes stay, and a second start goes on.

        Raises:
            NothingFoundError: If there is no such job.
        """
        with self._lock:
            job = self._jobs.get(number)
            if job is None:
                raise NothingFoundError(f"no export of the number {number}")
            if not job.is_open:
                return
            self._jobs[number] = replace(job, state=JobState.STOPPED)
            self._waiting = deque(each for each in self._waiting if each[0] != number)
            if self._running is not None and self._running[0] == number:
                self._running[1].terminate()

    def close(self) -> None:
        """Stop every job, and wait for the process that runs."""
        for job in self.jobs():
            self.stop(job.number)
        with self._lock:
            self._closed, thread = True, self._thread
        if thread is not None:
            thread.join(2 * _END_S)

    def _arguments(self, selection: str, form: str, *, bucket: str) -> list[str]:
        options = {"format": form, "out": self.place(selection, form), **self._options}
        if format_named(form).reads_logs and bucket:
            options["bucket"] = bucket
        flags = [part for name, value in options.items() for part in (f"--{name}", value)]
        return [*flags, "--", selection]

    def _forget(self) -> None:
        ended = [each.number for each in self._jobs.values() if not each.is_open]
        for number in ended[: max(0, len(ended) - MOST_KEPT)]:
            del self._jobs[number]

    def _run(self) -> None:
        """Run jobs until none waits."""
        while True:
            with self._lock:
                if self._closed or not self._waiting:
                    self._thread = None
                    return
                number, arguments = self._waiting.popleft()
                self._jobs[number] = replace(self._jobs[number], state=JobState.RUNNING)
                try:
                    process = self._started(arguments)
                except OSError as error:
                    text = f"the command did not start: {error.strerror or error}"
                    self._jobs[number] = replace(
                        self._jobs[number], state=JobState.FAILED, text=text
                    )
                    continue
                self._running = number, process
            self._follow(number, process)

    @staticmethod
    def _started(arguments: list[str]) -> subprocess.Popen[str]:
        return subprocess.Popen(  # noqa: S603
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
        )

    def _follow(self, number: int, process: subprocess.Popen[str]) -> None:
        """Read the output of a process until it ends."""
        told = threading.Thread(
            target=_each_line, args=(process.stderr, lambda line: self._tell(number, line))
        )
        told.start()
        _each_line(process.stdout, lambda line: self._count(number, line))
        try:
            code = process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
        told.join()
        with self._lock:
            self._running = None
            job = self._jobs[number]
            if job.state is JobState.RUNNING:
                states = {0: JobState.DONE, INCOMPLETE: JobState.INCOMPLETE}
                self._jobs[number] = replace(job, state=states.get(code, JobState.FAILED))

    def _tell(self, number: int, line: str) -> None:
        text = visible(line.strip()).removeprefix("error: ")
        if text:
            with self._lock:
                self._jobs[number] = replace(self._jobs[number], text=text[:1000])

    def _count(self, number: int, line: str) -> None:
        try:
            row: Any = json.loads(line)
        except ValueError:
            return
        if isinstance(row, dict) and "scene_id" in row:
            with self._lock:
                job = self._jobs[number]
                self._jobs[number] = replace(job, done=job.done + 1)


def folder_name(selection: str) -> str:
    """Return a name for the folder of a selection that any file system and bucket takes.

    A name with other characters ends with a digest, so that two selections never share a folder.
    """
    safe = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "-" for c in selection)
    if safe == selection and len(safe) <= _NAME_CHARACTERS:
        return safe
    return f"{safe[:_NAME_CHARACTERS]}-{sha256(selection.encode()).hexdigest()[:8]}"


def _each_line(stream: Any, take: Callable[[str], None]) -> None:
    with stream:
        for line in stream:
            take(line)
