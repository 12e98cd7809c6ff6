"""Two services on one PostgreSQL, a router and quick miners, as processes of their own."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, Protocol

from schemas.errors import TransientError
from schemas.transport.keys import DEFAULT_ROOT
from service.client import ControlClient
from tests.contracts.ledger_world import expected_scenes
from tests.free_ports import free_endpoint
from tests.integration.pair_logs import PairLogs, UnopenedLogs

ENVIRONMENT: Final = {
    "OMP_NUM_THREADS": "1",
    "COUNTERPOINT_LEASE_S": "3",
    "COUNTERPOINT_MAX_ATTEMPTS": "1000",
    "COUNTERPOINT_HTTP_LISTEN": "",
    "COUNTERPOINT_LOG_FORMAT": "json",
}
"""Settings under which a killed process costs seconds."""


class Process(Protocol):
    """Interface of a process that was started."""

    @property
    def pid(self) -> int:
        """Its id."""
        ...

    def send_signal(self, sig: int) -> None:
        """Send a signal to it."""
        ...

    def wait(self) -> int:
        """Wait for its end."""
        ...

    def poll(self) -> int | None:
        """Return its exit code; None while it runs."""
        ...


Spawn = Callable[[list[str], dict[str, str], Path], Process]
"""Starts a program with its arguments, more variables and a file for what it writes."""


def spawned(command: list[str], environment: dict[str, str], log: Path) -> Process:
    """Start a program as a child of this process."""
    with log.open("ab") as written:
        return subprocess.Popen(
            [sys.executable, "-m", *command],
            stdin=subprocess.DEVNULL,
            stdout=written,
            stderr=written,
            env=os.environ | environment,
        )


class Pair:
    """Processes by name: two services, routers and miners; each is killed or frozen at will."""

    def __init__(
        self,
        folder: Path,
        *,
        databases: Mapping[str, str],
        logs: int,
        miners: int,
        record_s: float = 0.02,
        routers: int = 1,
        logs_in: PairLogs | None = None,
        service_options: Sequence[str] = (),
        pools: Mapping[str, Sequence[str]] | None = None,
        variables_of: Callable[[str], Mapping[str, str]] = lambda name: {},
        through: Callable[[str], str] = lambda endpoint: endpoint,
        environment: Mapping[str, str] = ENVIRONMENT,
        spawn: Spawn = spawned,
    ) -> None:
        """Write the logs; `start` starts a process.

        Args:
            folder: For logs of cars, states, and what the processes write.
            databases: URL of the database by the name of each service.
            logs: Number of logs.
            miners: Number of quick miners, which open no log.
            record_s: Time of one record, seconds.
            routers: Number of routers, linked with each other.
            logs_in: The bucket; None: a folder for quick miners.
            service_options: Further arguments of the services.
            pools: Arguments of `counterpoint worker` by the name of each pool of workers.
            variables_of: Returns further variables of a process by its name.
            through: Maps the endpoint of a router to the one that services and miners use.
            environment: Variables of all processes.
            spawn: Starts a process that is no pool; a pool's workers would load the program again.
        """
        self._logs = logs_in or UnopenedLogs(folder)
        self._folder, self._spawn, self._environment = folder, spawn, dict(environment)
        self.log_ids: list[str] = []
        self.add_logs(logs)
        self.endpoints = [free_endpoint() for _ in range(routers)]
        connect = ",".join(map(through, self.endpoints))
        program = ["service.cli.main"]
        self._commands: dict[str, list[str]] = {}
        self._variables_of, self._databases = variables_of, dict(databases)
        for number, endpoint in enumerate(self.endpoints):
            linked = ",".join(other for other in self.endpoints[:number])
            link = ["--connect", linked] if linked else []
            self._commands[f"router-{number}"] = [*program, "router", "--listen", endpoint, *link]
        for name in databases:
            places = ("--bucket", self._logs.url, "--artifacts", self._logs.artifacts)
            at = ("--state", str(folder / name), "--connect", connect)
            serve = ("service", "--standby", *places, *at, *service_options)
            self._commands[name] = [*program, *serve]
        module = "tests.integration.quick_miner"
        for number in range(miners):
            miner = f"miner-{number}"
            self._commands[miner] = [module, connect, miner, "", str(record_s)]
        self.pools = tuple(pools or {})
        for name, options in (pools or {}).items():
            self._commands[name] = [*program, "worker", "--connect", connect, *options]
        self._running: dict[str, Process] = {}
        self.client = ControlClient(self.endpoints, root=DEFAULT_ROOT)

    def add_logs(self, count: int) -> None:
        """Upload further logs."""
        for number in range(len(self.log_ids), len(self.log_ids) + count):
            log_id = f"log-{number:04d}"
            self._logs.add(log_id)
            self.log_ids.append(log_id)

    @property
    def shards(self) -> int:
        """Number of shards of all logs."""
        return len(self.log_ids) * self._logs.shards_per_log

    def expected(self) -> dict[str, str]:
        """Return the digest of each scene of all logs of quick miners, by its id."""
        return expected_scenes(self.log_ids, shards=self._logs.shards_per_log)

    @property
    def names(self) -> list[str]:
        """Names of all processes, in the order in which they start."""
        return list(self._commands)

    def start(self, *names: str) -> None:
        """Start processes."""
        for name in names:
            environment = self._environment | dict(self._variables_of(name))
            if name in self._databases:
                environment["COUNTERPOINT_DATABASE"] = self._databases[name]
            log = self._folder / f"{name}.log"
            spawn = spawned if name in self.pools else self._spawn
            self._running[name] = spawn(self._commands[name], environment, log)

    def pid(self, name: str) -> int:
        """Return the id of a process that was started."""
        return self._running[name].pid

    def is_running(self, name: str) -> bool:
        """Return true if a process has been started and has not ended."""
        return name in self._running and self._running[name].poll() is None

    def send(self, name: str, sent: signal.Signals) -> None:
        """Send a signal to a process; one that kills is waited for."""
        self._running[name].send_signal(sent)
        if sent == signal.SIGKILL:
            self._running[name].wait()

    def end(self) -> None:
        """Kill all processes, frozen ones too."""
        for process in self._running.values():
            process.send_signal(signal.SIGKILL)
            process.wait()

    def said(self, name: str) -> str:
        """Return everything that a process has written."""
        path = self._folder / f"{name}.log"
        return path.read_text(errors="replace") if path.exists() else ""

    def serving(self, services: Sequence[str]) -> list[str]:
        """Return which services serve by the last of what each said about it."""
        found = []
        for name in services:
            lines = self.said(name).splitlines()
            last = [line for line in lines if "serving " in line or "standing by" in line]
            if last and "serving " in last[-1] and self.is_running(name):
                found.append(name)
        return found

    def done(self) -> int:
        """Return the number of shards that are done; -1 while no service answers."""
        try:
            return self.client.status().shards_by_state.get("done", 0)
        except TransientError:
            return -1

    def scenes(self) -> dict[str, str]:
        """Return the digest of each ranked scene, by its id."""
        return {row.scene_id: row.sha256 for row in self.client.top(most=1_000_000)}

    def words(self) -> str:
        """Return the last lines of all processes."""
        ends = ("\n".join(self.said(name).splitlines()[-12:]) for name in self.names)
        return "\n".join(f"--- {name}\n{end}" for name, end in zip(self.names, ends, strict=True))

    def until_done(self, shards: int, *, deadline_s: float = 120.0) -> float:
        """Wait until so many shards are done; return the seconds it took."""
        began_s = time.monotonic()
        while self.done() < shards:
            assert time.monotonic() - began_s < deadline_s, f"{self.done()}\n{self.words()}"
            time.sleep(0.05)
        return time.monotonic() - began_s
