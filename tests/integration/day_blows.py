"""What befalls the processes of a day, and who starts again what ends by itself."""

from collections.abc import Callable
from typing import Final, Literal

from tests.integration.bucket_hand import Hand
from tests.integration.daemons import System
from tests.integration.evening import Tally

Kill = Literal["service", "worker", "pool", "router", "store"]

KILLS: Final[tuple[Kill, ...]] = (
    *("service", "service", "worker", "worker", "pool", "router", "router", "store", "store"),
)
"""Of the day, spread over it in an order of its own; a killed worker is replaced by its pool."""

OF_MINERS: Final = ("worker", "pool")
"""What is killed only while something is mined: else nothing would be lost with it."""

EX_TEMPFAIL: Final = 75
NO_FOLDER: Final = "folder does not exist"
"""What a process may end with when its bucket is away as it starts."""


class Blows:
    """Kills, and takes the place of a service manager."""

    def __init__(
        self, system: System, hand: Hand, tally: Tally, *, say: Callable[[str, str], None]
    ) -> None:
        self._system, self._hand, self._tally, self._say = system, hand, tally, say

    def strike(self, what: Kill) -> None:
        """Kill something without a warning, and start it again."""
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
                self._hand.take_store_away(lambda how: self._say("kill", how))
                self._say("kill", "the store is there again")

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait, and meanwhile start again what ends by itself, as service managers do."""

        def looked_after() -> bool:
            self._look_after()
            return condition()

        self._system.until(looked_after, what)

    def _look_after(self) -> None:
        for daemon in self._system.daemons:
            code = daemon.ended()
            if code is None:
                continue
            last_words = daemon.said().strip().splitlines()[-1]
            # Started while its store was away, which is the one reason it may have.
            assert code == EX_TEMPFAIL or NO_FOLDER in last_words, daemon.words()
            self._say("ended", f"{daemon.name}, with {code}: {last_words}; it is started again")
            self._tally.ended[daemon.name] += 1
            daemon.start()
