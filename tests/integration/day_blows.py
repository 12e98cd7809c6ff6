"""What befalls the processes of a day, and who starts again what ends by itself."""

import random
import re
import time
from collections.abc import Callable
from typing import Final, Literal, get_args

from service.store.engine import DATABASE_NAME
from tests.integration.bucket_hand import Hand
from tests.integration.daemons import Daemon, System
from tests.integration.day_guests import Guest
from tests.integration.day_state import Loss, lose_database
from tests.integration.evening import Tally
from tests.integration.slow_http import hold_up

Kill = Literal["service", "worker", "pool", "router", "store"]
Trick = Literal[
    "odd entries", "absurd questions", "forged commits", "forged samples", "flood", "slow HTTP"
]
"""What the system must stand without a process of it ending."""

Blow = Kill | Trick | Loss

BLOWS: Final[tuple[Blow, ...]] = (*get_args(Kill), *get_args(Trick), *get_args(Loss))

_TWICE: Final = ("service", "worker", "router", "store", "forged commits")

OF_MINERS: Final = ("worker", "pool")
"""What is killed only while something is mined: else nothing would be lost with it."""

EX_TEMPFAIL: Final = 75
NO_FOLDER: Final = "folder does not exist"
"""What a process may end with when its bucket is away as it starts."""

STARTING_S: Final = 15.0
"""So long after its start a process may meet its bucket for the first time."""

SLOW_S: Final = 3.0

_FAULT: Final = re.compile(r"Traceback|fault of the program|panicked|Segmentation|MemoryError")


def blows(hand: Hand) -> tuple[Blow, ...]:
    """Name all of a day, which come in an order of its own; some come twice."""
    return tuple(
        blow
        for blow in BLOWS
        if blow != "odd entries" or hand.can_litter
        for _ in range(2 if blow in _TWICE else 1)
    )


class Blows:
    """Kills, plays tricks, and takes the place of a service manager."""

    def __init__(
        self,
        system: System,
        hand: Hand,
        tally: Tally,
        *,
        http: str,
        rng: random.Random,
        say: Callable[[str, str], None],
    ) -> None:
        """Take what is hit.

        Args:
            system: The processes.
            hand: Whoever has the bucket.
            tally: Where blows are counted.
            http: `host:port` where the service answers watchers.
            rng: Chooses among absurd things.
            say: Told who does what.
        """
        self._system, self._hand, self._tally, self._say = system, hand, tally, say
        self._http, self._guest = http, Guest(system.endpoint, system.state, rng)
        self._store_away_s = (0.0, 0.0)

    def strike(self, what: Blow) -> None:
        """Let one thing happen without a warning, and start again what it ends."""
        self._tally.kills[what] += 1
        match what:
            case "service":
                self._say("kill", "the service")
                self._system.service.restart()
            case "router":
                self._say("kill", "the router")
                self._system.router.restart()
            case "pool":
                self._say("kill", "the pool of workers, and all its workers with it")
                self._system.pool.restart()
            case "worker":
                self._say("kill", "a worker")
                self._system.kill_worker()
            case "store":
                began_s = time.monotonic()
                self._hand.take_store_away(lambda how: self._say("kill", how))
                self._store_away_s = (began_s, time.monotonic())
                self._say("kill", "the store is there again")
            case "database deleted" | "database replaced":
                self._lose_database(what)
            case _:
                self._trick(what)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait, and meanwhile start again what ends by itself, as service managers do."""

        def looked_after() -> bool:
            self._look_after()
            return condition()

        self._system.until(looked_after, what)

    def faults(self) -> list[str]:
        """Return the lines in which a process says that the program, not its world, is wrong."""
        return [
            f"{daemon.name}: {line}"
            for daemon in self._system.daemons
            for line in daemon.said().splitlines()
            if _FAULT.search(line)
        ]

    def _trick(self, what: Trick) -> None:
        self.until(lambda: self._system.status() is not None, "an answer")
        self._say("trick", what)
        match what:
            case "odd entries":
                self._hand.litter()
                outcome = "lie in the bucket"
            case "absurd questions":
                outcome = f"{self._guest.ask_absurdly()} refused"
            case "forged commits":
                outcome = f"{self._guest.forge_commits()} refused"
            case "forged samples":
                outcome = f"{self._guest.forge_samples()} put"
            case "flood":
                outcome = f"{self._guest.flood()} answered"
            case _:
                outcome = f"{hold_up(self._http, SLOW_S)} requests of others in vain"
        self._say("trick", f"{what}: {outcome}")
        self._look_after()

    def _lose_database(self, how: Loss) -> None:
        """Take the database from the service, which must say so and end, and bring it back."""
        self.until(lambda: self._system.status() is not None, "an answer")
        service = self._system.service
        said = len(service.said())
        self._say("kill", how)
        lose_database(
            self._system.state,
            how,
            until_ended=lambda: self._system.until(
                lambda: service.ended() is not None, "the service sees that its database is gone"
            ),
        )
        words = service.said()[said:]
        assert service.ended() == 1, f"it ends with {service.ended()}\n{service.words()}"
        last_words = words.strip().splitlines()[-1]
        assert "error: " in last_words, service.words()
        assert DATABASE_NAME in last_words, service.words()
        self._say("ended", f"the service: {last_words}")
        service.start()

    def _look_after(self) -> None:
        for daemon in self._system.daemons:
            code = daemon.ended()
            if code is None:
                continue
            last_words = daemon.said().strip().splitlines()[-1]
            may = code == EX_TEMPFAIL or NO_FOLDER in last_words
            assert may, daemon.words()
            assert self._was_starting_without_store(daemon), daemon.words()
            self._say("ended", f"{daemon.name}, with {code}: {last_words}; it is started again")
            self._tally.ended[daemon.name] += 1
            daemon.start()

    def _was_starting_without_store(self, daemon: Daemon) -> bool:
        """Whether it started while its store was away: the one reason to end that it may have."""
        gone_s, back_s = self._store_away_s
        return gone_s - STARTING_S < daemon.started_s < back_s
