"""Processes that mine logs, each watched: one that hangs, dies or grows too large is replaced."""

import json
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any, Final

from tests.fuzz.cases import case

LIMIT_S: Final = 15.0
"""Of a processor, for one log; the unharmed ones take a fifth of a second."""

WAIT_S: Final = 120.0
"""For one log, on a machine that does something else meanwhile."""

LIMIT_MB: Final = 1_500
START_S: Final = 600.0
"""For a process to load its parts; the first one on a machine compiles loops."""


@dataclass(frozen=True, slots=True)
class Run:
    """One log that was mined.

    Attributes:
        number: Of the log.
        encoding: Of its clouds.
        mutations: What was done to it.
        end: `mined`, `no scenes`, `refused`; a failure: `failed`, `died`, `hangs`, `too large`.
        problem: Why it was refused, or where the program failed.
        trace: Of a failure.
        scenes: Committed.
        shards: Planned.
        seconds: That it took.
        peak_mb: Most memory of the process meanwhile.
    """

    number: int
    encoding: str
    mutations: tuple[str, ...]
    end: str
    problem: str
    trace: str
    scenes: int
    shards: int
    seconds: float
    peak_mb: int

    @property
    def failed(self) -> bool:
        """Whether the program failed, not the log."""
        return self.end not in ("mined", "no scenes", "refused")


def run_all(
    numbers: Iterable[int],
    *,
    seed: int,
    workers: int,
    on_run: Callable[[Run], None] = lambda _: None,
) -> list[Run]:
    """Mine the logs of these numbers.

    Args:
        numbers: Which logs.
        seed: Makes them up.
        workers: Processes.
        on_run: Told of each log, as soon as it is over.
    """
    waiting, lock, runs = iter(numbers), threading.Lock(), list[Run]()

    def serve() -> None:
        worker = _Worker(seed)
        try:
            while True:
                with lock:
                    number = next(waiting, None)
                if number is None:
                    return
                run = worker.mine(number)
                with lock:
                    runs.append(run)
                    on_run(run)
        finally:
            worker.end()

    with ThreadPoolExecutor(workers) as pool:
        for served in [pool.submit(serve) for _ in range(workers)]:
            served.result()
    return sorted(runs, key=lambda run: run.number)


class _Worker:
    """One process, started when it is needed."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._process: subprocess.Popen[bytes] | None = None
        self._said = TemporaryFile()  # noqa: SIM115  # closed with the worker
        self._folder = TemporaryDirectory(prefix="fuzz-")
        """Where its state lies: a process that is killed leaves that behind."""

    def mine(self, number: int) -> Run:
        process = self._process or self._start()
        assert process.stdin is not None
        began_s = time.monotonic()
        process.stdin.write(json.dumps({"seed": self._seed, "number": number}).encode() + b"\n")
        process.stdin.flush()
        answer, peak_mb = self._answer(process, WAIT_S, cpu_s=LIMIT_S)
        if isinstance(answer, str):
            self._kill()
            answer = {"end": answer, "problem": self._last_words()}
        encoding, mutations, _ = case(self._seed, number)
        peak_mb = max(peak_mb, answer.get("peak_mb", 0))
        end = answer["end"]
        return Run(
            number=number,
            encoding=encoding,
            mutations=mutations,
            end="too large" if peak_mb > LIMIT_MB else end,
            problem=answer["problem"],
            trace=answer.get("trace", ""),
            scenes=answer.get("scenes", 0),
            shards=answer.get("shards", 0),
            seconds=time.monotonic() - began_s,
            peak_mb=peak_mb,
        )

    def end(self) -> None:
        self._kill()
        self._said.close()
        self._folder.cleanup()

    def _start(self) -> subprocess.Popen[bytes]:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.trial_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            env=os.environ | {"TMPDIR": self._folder.name},
        )
        ready, _ = self._answer(self._process, START_S)
        assert not isinstance(ready, str), f"no process to mine with: {self._last_words()}"
        return self._process

    def _answer(
        self, process: subprocess.Popen[bytes], limit_s: float, *, cpu_s: float = float("inf")
    ) -> tuple[dict[str, Any] | str, int]:
        """Wait for a line; or say why none comes. And the most memory seen meanwhile, MB."""
        assert process.stdout is not None
        end_s, peak_mb = time.monotonic() + limit_s, 0
        used_s = _cpu_s(process.pid)
        while time.monotonic() < end_s:
            if select.select([process.stdout], [], [], 0.05)[0]:
                line = process.stdout.readline()
                return (json.loads(line), peak_mb) if line else ("died", peak_mb)
            peak_mb = max(peak_mb, _rss_mb(process.pid))
            if peak_mb > LIMIT_MB:
                return "too large", peak_mb
            if _cpu_s(process.pid) - used_s > cpu_s:
                break
        return "hangs", peak_mb

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _last_words(self) -> str:
        self._said.seek(0)
        return self._said.read().decode(errors="replace")[-3000:]


def _cpu_s(pid: int) -> float:
    """Seconds of processors that a process has used; 0 when it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _rss_mb(pid: int) -> int:
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0
    return pages * 4096 // 1_000_000
