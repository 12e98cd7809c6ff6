"""A day in some minutes: logs appear, miners commit, subscribers listen; is anything growing?

Router, service, miners and subscribers are processes, bus and database are real; only the mining
is replaced by the time it takes and the records it leaves. Run it with

    python -m tests.benchmark.day --minutes 6 --plot deploy/images/day.png
"""

import argparse
import json
import os
import re
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from schemas.errors import TransientError
from schemas.transport.keys import DEFAULT_ROOT
from service.client import ControlClient
from service.store.engine import DATABASE_NAME
from tests.benchmark.day_miner import SCENES_PER_SHARD, SHARDS_PER_LOG
from tests.benchmark.day_sampling import Held, growth_per_1000, held_by
from tests.free_ports import free_endpoint

ROOT: Final = Path(__file__).resolve().parents[2]
WARM: Final = 0.25
"""Share of the day's scenes after which growth counts: caches and pools are full by then."""

DAY_S: Final = 86_400.0
MINE_S: Final = 20.0
"""What a worker with a processor takes for a shard of twenty seconds."""

LATE: Final = 0.5
"""Share of the day after which the late subscriber starts."""

ROWS: Final = 100
"""Rows of `top` that a person looks at."""

DRAIN_S: Final = 300.0


class Day:
    """Every process of one day, in one folder."""

    def __init__(
        self, folder: Path, *, minutes: float, logs: int, miners: int, look_every_s: float
    ) -> None:
        """Prepare; nothing runs yet."""
        self.folder, self.logs, self.miners = folder, logs, miners
        self.look_every_s = look_every_s
        self.length_s = 60.0 * minutes
        self.endpoint = free_endpoint()
        self.http = free_endpoint().removeprefix("tcp/")
        self.client = ControlClient([self.endpoint], root=DEFAULT_ROOT)
        self.bucket = folder / "logs"
        self.database = folder / "state" / DATABASE_NAME
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.samples: list[dict[str, Any]] = []
        self.looks: list[dict[str, float]] = []

    @property
    def expected(self) -> int:
        """Scenes at the end of the day."""
        return self.logs * SHARDS_PER_LOG * SCENES_PER_SHARD

    @contextmanager
    def running(self) -> Iterator[None]:
        """Start all but the late subscriber; stop everything at the end."""
        self.bucket.mkdir()
        counterpoint = ["-m", "service.cli.main"]
        try:
            self.start("router", *counterpoint, "router", "--listen", self.endpoint)
            state = ["--state", str(self.folder / "state")]
            bucket = ["--bucket", str(self.bucket), "--connect", self.endpoint]
            self.start("service", *counterpoint, "service", *bucket, *state)
            mine_s = str(MINE_S * self.length_s / DAY_S)
            for number in range(self.miners):
                name = f"miner {number}"
                noted = str(self.folder / f"commits-{number}.txt")
                self.start(
                    name, "-m", "tests.benchmark.day_miner", self.endpoint, name, mine_s, noted
                )
            self.subscribe("steady")
            yield
        finally:
            for process in reversed(self.processes.values()):
                process.send_signal(signal.SIGTERM)
            for process in reversed(self.processes.values()):
                process.wait(timeout=60)

    def subscribe(self, which: str) -> None:
        """Start a subscriber."""
        noted = str(self.arrivals(which))
        name = f"{which} subscriber"
        self.start(name, "-m", "tests.benchmark.day_subscriber", self.endpoint, noted)

    def arrivals(self, which: str) -> Path:
        """Where a subscriber notes what came."""
        return self.folder / f"{which}.tsv"

    def start(self, name: str, *arguments: str) -> None:
        """Start one process."""
        with (self.folder / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, *arguments],
                cwd=ROOT,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env=os.environ
                | {
                    "OMP_NUM_THREADS": "1",
                    "COUNTERPOINT_HTTP_LISTEN": self.http if name == "service" else "",
                    "COUNTERPOINT_LIST_INTERVAL_S": "2",
                },
            )

    def go_through(self) -> None:
        """Let the logs of the day appear, one after the other, until all are mined."""
        begun_s, written, next_look_s = time.monotonic(), 0, self.look_every_s
        while True:
            now_s = time.monotonic() - begun_s
            due = min(self.logs, 1 + int(self.logs * now_s / self.length_s))
            for number in range(written, due):
                log = self.bucket / f"car-{number % 10}" / f"{number:05d}.mcap"
                log.parent.mkdir(exist_ok=True)
                log.write_bytes(b"never opened")
            written = due
            if now_s > LATE * self.length_s and "late subscriber" not in self.processes:
                self.subscribe("late")
            scenes = self._sample(now_s)
            if scenes and now_s > next_look_s:
                self._look(scenes)
                next_look_s += self.look_every_s
            if scenes >= self.expected and self._all_heard():
                self._look(scenes)
                return
            if now_s > self.length_s + DRAIN_S:
                raise SystemExit(f"not mined in time: {scenes} of {self.expected} scenes")
            time.sleep(max(0.0, 1.0 - (time.monotonic() - begun_s - now_s)))

    def _sample(self, now_s: float) -> int:
        held: dict[str, Held] = {}
        for name, process in self.processes.items():
            if process.poll() is not None:
                raise SystemExit(f"{name} ended; see {self.folder / name}.log")
            held[name] = held_by(process.pid)
        wal = self.database.with_name(f"{DATABASE_NAME}-wal")
        scenes = self._scenes()
        self.samples.append(
            {
                "at_s": now_s,
                "scenes": scenes,
                "database_mib": _mib(self.database),
                "wal_mib": _mib(wal),
                "held": held,
            }
        )
        return scenes

    def _scenes(self) -> int:
        try:
            with closing(sqlite3.connect(f"file:{self.database}?mode=ro", uri=True)) as connection:
                row = connection.execute("SELECT value FROM counters WHERE name = 'seq'").fetchone()
        except sqlite3.OperationalError:  # the service has not made it yet
            return 0
        return int(row[0])

    def _look(self, scenes: int) -> None:
        looked: dict[str, float] = {"scenes": scenes, "staging_mib": self._staging_mib()}
        for verb, ask in (("status", self.client.status), ("top", partial(self.client.top, ROWS))):
            begun_s = time.monotonic()
            try:
                ask()
            except TransientError:
                continue
            looked[f"{verb}_s"] = round(time.monotonic() - begun_s, 3)
        self.looks.append(looked)

    def _staging_mib(self) -> float:
        """Scrape the service as Prometheus would, for what waits for its commit."""
        with urllib.request.urlopen(f"http://{self.http}/metrics", timeout=60) as reply:
            text = reply.read().decode()
        found = re.search(r"^counterpoint_staging_bytes (\S+)$", text, re.MULTILINE)
        return round(float(found.group(1)) / 2**20, 2) if found is not None else float("nan")

    def _all_heard(self) -> bool:
        return all(_lines(self.arrivals(which)) >= self.expected for which in ("steady", "late"))


def summary(day: Day) -> dict[str, Any]:
    """Say what grew, how fast commits were, and when scenes arrived."""
    scenes = np.array([sample["scenes"] for sample in day.samples], dtype=float)
    processes = {}
    for name in day.processes:
        here = np.array([name in sample["held"] for sample in day.samples])
        series = [sample["held"][name] for sample in day.samples if name in sample["held"]]

        def grown(field: str, here: Any = here, series: Any = series) -> float:
            values = np.array([getattr(held, field) for held in series], dtype=float)
            return growth_per_1000(scenes[here], values, warm=WARM)

        processes[name] = {
            "pss_mib": round(series[-1].pss_mib, 1),
            "pss_mib_per_1000_scenes": round(grown("pss_mib"), 3),
            "handles": series[-1].handles,
            "handles_per_1000_scenes": round(grown("handles"), 3),
            "threads": series[-1].threads,
            "threads_per_1000_scenes": round(grown("threads"), 3),
            "cpu_s": round(series[-1].cpu_s, 1),
        }
    commits_s = np.concatenate(
        [np.loadtxt(path, ndmin=1) for path in sorted(day.folder.glob("commits-*.txt"))]
    )
    wall_s = day.samples[-1]["at_s"]
    return {
        "scenes": int(scenes[-1]),
        "wall_s": round(wall_s, 1),
        "scenes_per_s": round(scenes[-1] / wall_s, 1),
        "commits": len(commits_s),
        "commits_per_s": round(len(commits_s) / wall_s, 1),
        "commit_ms": _spread_ms(commits_s),
        "publication_ms": _spread_ms(_publication_s(day)),
        "subscribers": {which: _heard(day.arrivals(which)) for which in ("steady", "late")},
        "database_mib": round(day.samples[-1]["database_mib"], 1),
        "wal_mib_most": round(max(sample["wal_mib"] for sample in day.samples), 1),
        "looks": day.looks,
        "processes": processes,
    }


def plot(day: Day, path: Path) -> None:
    """Draw memory, handles and database over the scenes of the day."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(12, 7.5), layout="constrained", sharex=True)
    hours = np.array([sample["at_s"] for sample in day.samples]) * 24.0 * 3600.0 / DAY_S
    hours *= DAY_S / 3600.0 / day.length_s
    for panel, field, title in (
        (axes[0, 0], "pss_mib", "memory, MiB (proportional set)"),
        (axes[0, 1], "handles", "open files and sockets"),
        (axes[1, 0], "threads", "threads"),
    ):
        for name in day.processes:
            at = [
                (hour, getattr(sample["held"][name], field))
                for hour, sample in zip(hours, day.samples, strict=True)
                if name in sample["held"]
            ]
            panel.plot(*zip(*at, strict=True), label=name)
        panel.set_title(title)
        panel.set_ylim(bottom=0)
        panel.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=7, ncol=2)
    ledger = axes[1, 1]
    ledger.plot(hours, [sample["database_mib"] for sample in day.samples], label="database, MiB")
    ledger.plot(hours, [sample["wal_mib"] for sample in day.samples], label="its journal, MiB")
    ledger.plot(hours, [sample["scenes"] / 1000 for sample in day.samples], label="1000 scenes")
    ledger.set_title("ledger")
    ledger.set_ylim(bottom=0)
    ledger.legend()
    ledger.grid(alpha=0.3)
    for panel in axes[1]:
        panel.set_xlabel("hour of the day that is played")
    figure.suptitle(
        f"24 hours in {day.length_s / 60:g} minutes: {day.expected} scenes of {day.logs} logs "
        "through bus and ledger"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _publication_s(day: Day) -> Any:
    """From the commit of a scene's shard to its arrival at the steady subscriber."""
    with closing(sqlite3.connect(f"file:{day.database}?mode=ro", uri=True)) as connection:
        committed_s = dict(
            connection.execute(
                "SELECT scene_id, committed_s FROM scenes JOIN shards ON shards.name = scenes.shard"
                " AND shards.log_id = scenes.log_id AND shards.revision = scenes.revision"
                " AND shards.pipeline_version = scenes.pipeline_version"
            ).fetchall()
        )
    rows = (line.split("\t") for line in day.arrivals("steady").read_text().splitlines())
    return np.array([float(row[0]) - committed_s[row[2]] for row in rows])


def _heard(path: Path) -> Mapping[str, int]:
    rows = [line.split("\t") for line in path.read_text().splitlines()]
    return {"events": len(rows), "scenes": len({row[2] for row in rows})}


def _spread_ms(values_s: Any) -> dict[str, float]:
    shares = {"median": 50, "p99": 99, "most": 100}
    return {
        name: round(1e3 * float(np.percentile(values_s, share)), 2)
        for name, share in shares.items()
    }


def _lines(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def _mib(path: Path) -> float:
    return path.stat().st_size / 2**20 if path.exists() else 0.0


def main() -> None:
    """Play the day, print the summary as JSON."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=float, default=6.0)
    options.add_argument("--logs", type=int, default=210)
    options.add_argument("--miners", type=int, default=4)
    options.add_argument("--look-every", type=float, default=15.0, help="status and top, seconds")
    options.add_argument("--plot", type=Path)
    given = options.parse_args()
    with ExitStack() as opened:
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="day-")))
        day = Day(
            folder,
            minutes=given.minutes,
            logs=given.logs,
            miners=given.miners,
            look_every_s=given.look_every,
        )
        with day.running():
            day.go_through()
        sys.stdout.write(json.dumps(summary(day), indent=2) + "\n")
        if given.plot is not None:
            plot(day, given.plot)


if __name__ == "__main__":
    main()
