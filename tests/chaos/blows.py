"""Blows to the system, drawn from a seed: kills, freezes, cut networks, a full disk."""

import heapq
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from typing import Final, Literal

from tests.chaos.world import ChaosWorld

Blow = Literal["kill", "freeze", "cut", "drop", "crash of the database", "full disk"]

WEIGHTS: Final[dict[Blow, float]] = {
    "kill": 0.83,
    "freeze": 0.06,
    "cut": 0.05,
    "drop": 0.02,
    "crash of the database": 0.02,
    "full disk": 0.02,
}
"""Shares of the blows. Kills are the most; the others take seconds each."""

MOST_AT_ONCE: Final = 3
"""Parts that are down, frozen or cut at the same time."""


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

    @property
    def kills(self) -> int:
        """Number of kills so far."""
        return self.killed.total()

    def step(self) -> None:
        """Heal what is due, deal one more blow, and wait for a moment."""
        self._heal_due()
        if len(self._hit) < MOST_AT_ONCE:
            kinds = list(WEIGHTS)
            (blow,) = self._random.choices(kinds, [WEIGHTS[kind] for kind in kinds])
            self._deal(blow)
        time.sleep(self._random.uniform(0.02, 0.25))

    def heal(self) -> None:
        """Heal everything."""
        for part in list(self._hit):
            self._hit.pop(part)()
        self._due.clear()

    def _deal(self, blow: Blow) -> None:
        pair = self._world.pair
        if blow in ("kill", "freeze"):
            part = self._random.choice([name for name in pair.names if name not in self._hit])
            if blow == "kill":
                pair.send(part, signal.SIGKILL)
                self.killed[part.rpartition("-")[0]] += 1
                self._note(blow, part, lambda: pair.start(part), self._random.uniform(0.0, 0.6))
                return
            pair.send(part, signal.SIGSTOP)
            seconds = self._random.choice((0.5, 2.0, 8.0))
            self._note(blow, part, lambda: pair.send(part, signal.SIGCONT), seconds)
        elif blow in ("cut", "drop"):
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
        elif "database" in self._hit:
            return
        elif blow == "full disk":
            if self._world.has_small_disk:
                self._world.fill_disk()
                seconds = self._random.uniform(0.5, 3.0)
                self._note(blow, "database", self._world.empty_disk, seconds)
        else:
            self._world.stop_postgres()
            self.killed["database"] += 1
            seconds = self._random.uniform(0.0, 2.0)
            self._note(blow, "database", self._world.ensure_postgres, seconds)

    def _note(self, blow: Blow, part: str, heal: Callable[[], None], seconds: float) -> None:
        self.dealt[blow] += 1
        self._hit[part] = heal
        heapq.heappush(self._due, (time.monotonic() + seconds, part))

    def _heal_due(self) -> None:
        while self._due and self._due[0][0] <= time.monotonic():
            _, part = heapq.heappop(self._due)
            self._hit.pop(part)()
