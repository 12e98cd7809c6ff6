"""A service under a flood of questions and forged records: its memory, and what workers still do.

python -m tests.benchmark.flood [--questions 50000] [--forged 10000] [--locked] [--elsewhere]

Router, service, two miners and the flooding clients are processes. A miner leases, publishes and
commits as a worker does, and waits in the place of mining.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

from sqlalchemy import Connection, func, select

from schemas.errors import TransientError
from schemas.transport.keys import DEFAULT_ROOT as ROOT
from schemas.transport.keys import OWNER_END
from schemas.transport.locks import OPEN
from service.client import ControlClient
from service.security.access_rules import access_rules
from service.security.authority import open_authority
from service.security.names import BusRole
from service.store.engine import open_store_to_read
from service.store.tables import LISTED_SCENES
from tests.benchmark.day_sampling import held_by
from tests.free_ports import free_endpoint, free_port
from tests.integration.daemons import Daemon
from tests.integration.quick_miner import locks_of

LOGS: Final = 4_000
MINERS: Final = ("miner-0", "miner-1")
ROLES: Final[Mapping[str, BusRole]] = {
    "router": "router", "service": "service", "miner-0": "worker", "miner-1": "worker",
    "reader": "reader",
}  # fmt: skip
RECORD_S: Final = "0.05"
SETTLED_S: Final = 3.0
EACH_S: Final = 0.25


@dataclass
class Flooded:
    """Figures of one flood.

    Attributes:
        questions: Asked.
        forged: Records put in the names of workers, and of none.
        locked: Mutual TLS and access control; the flood has a reader's certificate.
        elsewhere: The flooding clients have the lowest priority, as if they ran on other machines.
        ends: How often a question was answered, refused, or left alone.
        flood_s: Seconds until the last question had ended.
        calm: Scenes a second of honest workers before the flood.
        flooded: During it.
        after: After it.
        recovered_s: Seconds from its end to the first answer within a second.
        memory_mib: Memory of the service before, at most, and ten seconds after.
        scenes: Committed by honest workers in all.
        foreign: Scenes in the ledger of logs that are not in the bucket.
    """

    questions: int
    forged: int
    locked: bool
    elsewhere: bool
    ends: dict[str, int] = field(default_factory=dict)
    flood_s: float = 0.0
    calm: float = 0.0
    flooded: float = 0.0
    after: float = 0.0
    recovered_s: float = 0.0
    memory_mib: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scenes: int = 0
    foreign: int = 0


class Fleet:
    """Router, service and honest miners over a bucket of logs that are never opened."""

    def __init__(self, folder: Path, *, locked: bool) -> None:
        self._folder = folder
        (folder / "logs").mkdir()
        for number in range(LOGS):
            (folder / "logs" / f"log-{number:04d}.mcap").write_bytes(b"never opened")
        self.endpoint = f"tls/127.0.0.1:{free_port()}" if locked else free_endpoint()
        self.authority = folder / "authority" if locked else None
        self.state = folder / "state"
        if self.authority is not None:
            self._make_locks(self.authority)
        at = ("--connect", self.endpoint)
        serve = ("service", "--bucket", str(folder / "logs"), "--state", str(self.state), *at)
        self.router = Daemon(
            folder, "router", "router", "--listen", self.endpoint, env=self._env("router")
        )
        self.service = Daemon(
            folder, "service", *serve, env={"COUNTERPOINT_LEASE_S": "30"} | self._env("service")
        )
        self._miners: list[subprocess.Popen[bytes]] = []

    @contextmanager
    def running(self) -> Iterator[None]:
        """Start all, and end all."""
        self.router.start()
        self.service.start()
        with (self._folder / "miners.log").open("ab") as said:
            for name in MINERS:
                miner_id = f"{name}{OWNER_END}0" if self.authority else name
                module = [sys.executable, "-m", "tests.integration.quick_miner", self.endpoint]
                command = [*module, miner_id, "", RECORD_S, str(self.authority or "")]
                self._miners.append(subprocess.Popen(command, stdout=said, stderr=said))
        try:
            yield
        finally:
            for miner in self._miners:
                miner.kill()
                miner.wait()
            self.service.end()
            self.router.end()

    def client(self) -> ControlClient:
        """Return a client that may read."""
        locks = locks_of(self.authority, "reader") if self.authority else OPEN
        return ControlClient([self.endpoint], root=ROOT, locks=locks)

    def client_answers(self) -> bool:
        """Return True if the service answers a client."""
        try:
            self.client().status()
        except TransientError:
            return False
        return True

    def _make_locks(self, folder: Path) -> None:
        authority = open_authority(folder)
        names: dict[str, list[str]] = {}
        for name, role in ROLES.items():
            authority.issue(name, role)
            names.setdefault(role, []).append(name)
        rules = json.dumps(access_rules(names, root=ROOT))
        (self._folder / "rules.json").write_text(rules)

    def _env(self, name: str) -> dict[str, str]:
        if self.authority is None:
            return {}
        locks = locks_of(self.authority, name)
        laid = {"COUNTERPOINT_ZENOH_CONFIG": str(self._folder / "rules.json")}
        return {
            "COUNTERPOINT_TLS_CA": locks.ca,
            "COUNTERPOINT_TLS_CERTIFICATE": locks.certificate,
            "COUNTERPOINT_TLS_KEY": locks.key,
            "COUNTERPOINT_EXPECTED_VERSIONS": "p1",
        } | (laid if name == "router" else {})


class Watch(threading.Thread):
    """Samples scenes and memory of the service, until told to stop."""

    def __init__(self, fleet: Fleet) -> None:
        super().__init__(daemon=True)
        self._fleet, self._over = fleet, threading.Event()
        self.samples: list[tuple[float, int, float]] = []

    def run(self) -> None:
        """Sample time, scenes and MiB."""
        with closing(open_store_to_read(self._fleet.state)) as store:
            while not self._over.wait(EACH_S):
                with store.reading() as connection:
                    scenes = _scenes(connection)
                held = held_by(self._fleet.service.pid)
                self.samples.append((time.monotonic(), scenes, held.pss_mib))

    def stop(self) -> None:
        """End it."""
        self._over.set()
        self.join()

    def rate(self, first_s: float, last_s: float) -> float:
        """Return the scenes a second between two instants."""
        within = [each for each in self.samples if first_s <= each[0] <= last_s]
        return (within[-1][1] - within[0][1]) / (within[-1][0] - within[0][0])

    def most_mib(self, first_s: float, last_s: float) -> float:
        """Return the most memory between two instants."""
        return max(each[2] for each in self.samples if first_s <= each[0] <= last_s)


def flood(
    folder: Path,
    *,
    questions: int,
    forged: int,
    clients: int,
    locked: bool,
    elsewhere: bool,
    calm_s: float,
) -> Flooded:
    """Flood a service, and measure it before, meanwhile and after.

    Args:
        folder: For state and logs.
        questions: In all.
        forged: Records, in all.
        clients: Processes that share them.
        locked: Mutual TLS; the flood has a reader's certificate.
        elsewhere: Give the flooding clients the processor time that the others leave.
        calm_s: Seconds of the measurements before and after.
    """
    fleet = Fleet(folder, locked=locked)
    found = Flooded(questions, forged, locked, elsewhere)
    with fleet.running():
        _until_scenes(fleet)
        watch = Watch(fleet)
        watch.start()
        time.sleep(SETTLED_S)
        calm_from = time.monotonic()
        time.sleep(calm_s)
        began_s = time.monotonic()
        found.ends = dict(_run_clients(fleet, found, clients))
        ended_s = time.monotonic()
        _until_answered(fleet)
        found.recovered_s = round(time.monotonic() - ended_s, 2)
        again_s = time.monotonic()
        time.sleep(calm_s)
        over_s = time.monotonic()
        watch.stop()
        found.flood_s = round(ended_s - began_s, 1)
        found.calm = round(watch.rate(calm_from, began_s), 1)
        found.flooded = round(watch.rate(began_s, ended_s), 1)
        found.after = round(watch.rate(again_s, over_s), 1)
        spans = ((calm_from, began_s), (began_s, ended_s), (over_s - 2.0, over_s))
        before, most, after = (round(watch.most_mib(*span), 1) for span in spans)
        found.memory_mib = (before, most, after)
        rows = fleet.client().top()
        found.scenes = len(rows)
        found.foreign = sum("forged" in row.log_id for row in rows)
    return found


def _run_clients(fleet: Fleet, asked: Flooded, clients: int) -> Counter[str]:
    locks = (str(fleet.authority), "reader") if fleet.authority else ()
    last = ["nice", "-n", "19"] if asked.elsewhere else []
    module = [*last, sys.executable, "-m", "tests.benchmark.flooding", fleet.endpoint]
    shares = (str(asked.questions // clients), str(asked.forged // clients))
    running = [
        subprocess.Popen([*module, *shares, str(seed), *locks], stdout=subprocess.PIPE)
        for seed in range(clients)
    ]
    ends = Counter[str]()
    for each in running:
        said, _ = each.communicate()
        ends.update(json.loads(said)["ends"])
    return ends


def _scenes(connection: Connection) -> int:
    return connection.execute(select(func.count()).select_from(LISTED_SCENES)).scalar_one()


def _until_scenes(fleet: Fleet) -> None:
    while not fleet.client_answers() or not fleet.client().top(1):
        time.sleep(0.2)


def _until_answered(fleet: Fleet) -> None:
    while True:
        began_s = time.monotonic()
        if fleet.client_answers() and time.monotonic() - began_s < 1.0:
            return


def main() -> None:
    """Flood, and print the figures as JSON."""
    asked = argparse.ArgumentParser(prog="python -m tests.benchmark.flood")
    asked.add_argument("--questions", type=int, default=50_000)
    asked.add_argument("--forged", type=int, default=10_000)
    asked.add_argument("--clients", type=int, default=2)
    asked.add_argument("--calm-s", type=float, default=15.0)
    asked.add_argument("--locked", action="store_true")
    asked.add_argument("--elsewhere", action="store_true", help="the flood has the lowest priority")
    asked.add_argument("--folder", type=Path, help="kept, with state and logs of the processes")
    how = asked.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory(prefix="flooded-") as folder:
        if how.folder is not None:
            how.folder.mkdir(parents=True)
        found = flood(
            how.folder or Path(folder),
            questions=how.questions,
            forged=how.forged,
            clients=how.clients,
            locked=how.locked,
            elsewhere=how.elsewhere,
            calm_s=how.calm_s,
        )
    sys.stdout.write(json.dumps(asdict(found), indent=1) + "\n")


if __name__ == "__main__":
    main()
