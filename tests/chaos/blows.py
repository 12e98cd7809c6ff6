"""Blows to the system, drawn from a seed: kills, freezes, cut networks, set clocks, a full disk."""

import heapq
import os
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from typing import Final, Literal

from tests.chaos.clocks import AHEAD_S, REFUSED_S
from tests.chaos.world import ChaosWorld
from tests.integration.daemons import workers_of

Blow = Literal[
    "kill",
    "freeze",
    "cut",
    "drop",
    "clock set",
    "refused clock",
    "crash of the database",
    "full disk",
    "kill of a worker",
    "kill of the gateway",
    "frozen gateway",
    "loss of a node",
]

WEIGHTS: Final[dict[Blow, float]] = {
    "kill": 0.80,
    "freeze": 0.06,
    "cut": 0.05,
    "drop": 0.02,
    "clock set": 0.05,
    "crash of the database": 0.02,
    "full disk": 0.02,
}
"""Shares of the blows where quick miners mine. Kills are the most; others take seconds each."""

STREET_WEIGHTS: Final[dict[Blow, float]] = {
    "kill": 0.38,
    "freeze": 0.08,
    "cut": 0.10,
    "drop": 0.05,
    "clock set": 0.08,
    "refused clock": 0.03,
    "crash of the database": 0.03,
    "full disk": 0.02,
    "kill of a worker": 0.08,
    "kill of the gateway": 0.08,
    "frozen gateway": 0.05,
    "loss of a node": 0.04,
}
"""Shares where workers mine streets; what a system does not have is left out."""

MOST_AT_ONCE: Final = 3
"""Parts that are down, frozen or cut at the same time."""

POOL_REST_S: Final = 10.0
"""Time after its start before a pool is hit again, seconds: its workers load for some of it."""


class Blows:
    """Deals blows and heals them again, one after the other and some at a time.

    Attributes:
        dealt: Number of each blow so far.
        killed: Number of kills of each process; a crash of the database is one.
    """

    def __init__(self, world: ChaosWorld, *, seed: int) -> None:
        """Prepare.

        Args:
            world: The system.
            seed: Of the order and the times of all blows.
        """
        self._world, self._random = world, random.Random(seed)  # noqa: S311
        self.dealt: Counter[Blow] = Counter()
        self.killed: Counter[str] = Counter()
        self._hit: dict[str, Callable[[], None]] = {}
        """Healing function of each part that is hit now, by name."""
        self._due: list[tuple[float, str]] = []
        self._rests_until_s: dict[str, float] = {}
        is_quick = world.parts.pool == "quick"
        self._waits_s = (0.02, 0.25) if is_quick else (0.05, 0.8)
        self._shares = {
            blow: share
            for blow, share in (WEIGHTS if is_quick else STREET_WEIGHTS).items()
            if self._is_possible(blow)
        }

    @property
    def kills(self) -> int:
        """Number of kills so far."""
        return self.killed.total()

    def step(self) -> None:
        """Heal what is due, deal one more blow, and wait for a moment."""
        self._heal_due()
        if len(self._hit) < MOST_AT_ONCE:
            (blow,) = self._random.choices([*self._shares], [*self._shares.values()])
            self._deal(blow)
        time.sleep(self._random.uniform(*self._waits_s))

    def heal(self) -> None:
        """Heal everything; clocks stay as they were set."""
        for part in list(self._hit):
            self._hit.pop(part)()
        self._due.clear()

    def _is_possible(self, blow: Blow) -> bool:
        world = self._world
        match blow:
            case "clock set":
                return world.clocks is not None
            case "refused clock":
                return world.clocks is not None and world.gateway is not None
            case "kill of the gateway" | "frozen gateway":
                return world.gateway is not None
            case "loss of a node":
                return world.nodes is not None
            case "kill of a worker":
                return world.parts.pool == "local"
            case "full disk":
                return world.has_small_disk
            case _:
                return True

    def _deal(self, blow: Blow) -> None:
        match blow:
            case "kill" | "freeze":
                self._hit_process(blow)
            case "cut" | "drop":
                self._hit_network(blow)
            case "clock set":
                self._set_clock(self._random.choice(self._world.pair.names))
            case "refused clock":
                self._refuse_clock()
            case "crash of the database" | "full disk":
                self._hit_database(blow)
            case "kill of a worker":
                self._kill_worker()
            case "kill of the gateway" | "frozen gateway":
                self._hit_gateway(blow)
            case "loss of a node":
                self._lose_node()

    def _hit_process(self, blow: Blow) -> None:
        pair, now_s = self._world.pair, time.monotonic()
        able = [
            name
            for name in pair.names
            if name not in self._hit and self._rests_until_s.get(name, 0.0) <= now_s
        ]
        part = self._random.choice(able)
        if blow == "kill":
            pair.send(part, signal.SIGKILL)
            self.killed[part.rpartition("-")[0] or part] += 1
            self._note(blow, part, lambda: self._start(part), self._random.uniform(0.0, 0.6))
            return
        pair.send(part, signal.SIGSTOP)
        seconds = self._random.choice((0.5, 2.0, 8.0))
        self._note(blow, part, lambda: pair.send(part, signal.SIGCONT), seconds)

    def _start(self, part: str) -> None:
        self._world.pair.start(part)
        if part in self._world.pair.pools:
            self._rests_until_s[part] = time.monotonic() + POOL_REST_S

    def _hit_network(self, blow: Blow) -> None:
        name = self._random.choice(list(self._world.networks))
        network = self._world.networks[name]
        if name in self._hit:
            return
        if blow == "drop":
            network.drop()
            self.dealt[blow] += 1
            return
        network.cut()
        self._note(blow, name, network.heal, self._random.choice((0.5, 2.0, 8.0)))

    def _set_clock(self, name: str) -> None:
        assert self._world.clocks is not None
        self._world.clocks.set(name, self._random.choice(AHEAD_S))
        self.dealt["clock set"] += 1

    def _refuse_clock(self) -> None:
        """Set a clock so wrong that the gateway refuses its process, and set it right later."""
        clocks = self._world.clocks
        assert clocks is not None
        name = self._random.choice(self._world.pair.names)
        part = f"clock of {name}"
        if part in self._hit:
            return
        clocks.set(name, self._random.choice(REFUSED_S))
        seconds = self._random.choice((3.0, 9.0))
        self._note("refused clock", part, lambda: self._set_clock(name), seconds)

    def _hit_database(self, blow: Blow) -> None:
        if "database" in self._hit:
            return
        if blow == "full disk":
            self._world.fill_disk()
            seconds = self._random.uniform(0.5, 3.0)
            self._note(blow, "database", self._world.empty_disk, seconds)
            return
        self._world.stop_postgres()
        self.killed["database"] += 1
        seconds = self._random.uniform(0.0, 2.0)
        self._note(blow, "database", self._world.ensure_postgres, seconds)

    def _kill_worker(self) -> None:
        workers = workers_of(self._world.pair.pid("pool"))
        if workers:
            os.kill(self._random.choice(workers), signal.SIGKILL)
            self.killed["worker"] += 1
            self.dealt["kill of a worker"] += 1

    def _hit_gateway(self, blow: Blow) -> None:
        gateway = self._world.gateway
        assert gateway is not None
        if "gateway" in self._hit:
            return
        seconds = self._random.choice((0.0, 0.5, 3.0, 9.0, 15.0))
        if blow == "kill of the gateway":
            gateway.kill()
            self.killed["gateway"] += 1
            self._note(blow, "gateway", gateway.start, seconds)
            return
        gateway.freeze()
        self._note(blow, "gateway", gateway.thaw, seconds)

    def _lose_node(self) -> None:
        nodes = self._world.nodes
        assert nodes is not None
        if "node" in self._hit:
            return
        nodes.kill(self._random.randrange(len(nodes)))
        self.killed["node"] += 1
        self._note("loss of a node", "node", nodes.add, self._random.uniform(1.0, 6.0))

    def _note(self, blow: Blow, part: str, heal: Callable[[], None], seconds: float) -> None:
        self.dealt[blow] += 1
        self._hit[part] = heal
        heapq.heappush(self._due, (time.monotonic() + seconds, part))

    def _heal_due(self) -> None:
        while self._due and self._due[0][0] <= time.monotonic():
            _, part = heapq.heappop(self._due)
            self._hit.pop(part)()
