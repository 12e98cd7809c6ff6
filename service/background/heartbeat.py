"""One line now and then: a quiet daemon says that it lives, a busy one how far it has come."""

import time
from collections.abc import Callable, Mapping
from typing import Final, TypeAlias

import structlog
import zenoh

from schemas.transport import keys
from service.store.ledger import Ledger
from service.store.work_items import WorkState

log = structlog.get_logger(__name__)

LOOK_S: Final = 5.0
"""How often to look whether a line is due."""

BUSY_S: Final = 60.0
"""While things change, one line sums up each minute, however much happens in it."""

WORK: Final = ("logs_waiting", "logs_growing", "shards_waiting", "shards_leased")
"""A daemon with any of these is not quiet, however long it is silent: a slow shard is no idling."""

Standing: TypeAlias = Mapping[str, int | float | None]
"""How things stand, by name; what ends in `_s` grows by itself and is no news."""


class Heartbeat:
    """Says how a daemon stands: once in a while when nothing changes, each minute when it does."""

    def __init__(
        self,
        standing: Callable[[], Standing],
        *,
        heartbeat_s: float,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin to count.

        Args:
            standing: Says how things stand; asked only when a line may be due.
            heartbeat_s: Longest silence, seconds.
            clock_s: Seconds that never step back.
        """
        self._standing, self._heartbeat_s, self._clock_s = standing, heartbeat_s, clock_s
        self._said_at_s = clock_s()
        self._said: Standing | None = None

    @property
    def interval_s(self) -> float:
        """How often `beat` wants to be called, seconds."""
        return min(LOOK_S, self._heartbeat_s)

    def beat(self) -> None:
        """Say how things stand, if it is time to."""
        silent_s = self._clock_s() - self._said_at_s
        if silent_s < min(BUSY_S, self._heartbeat_s):
            return
        standing = self._standing()
        news = {
            name: count - before
            for name, count in standing.items()
            if not name.endswith("_s")
            and isinstance(count, int)
            and isinstance(before := (self._said or {}).get(name, 0), int)
            and count != before
        }
        if not news and silent_s < self._heartbeat_s:
            return
        is_first, self._said, self._said_at_s = self._said is None, standing, self._clock_s()
        change = 0 if is_first else news.get("scenes", 0)
        name = "new_scenes" if change > 0 else "withdrawn_scenes"
        new_scenes = {name: abs(change)} if change else {}
        waits = any(standing.get(name) for name in WORK)
        log.info("busy" if news or waits else "quiet", **standing, **new_scenes)


def service_standing(
    ledger: Ledger, session: zenoh.Session, *, root: str, listed_s: float | None
) -> Standing:
    """How a service stands: what is found, what waits, who works, when the bucket was last seen.

    Args:
        ledger: What is found and waits.
        session: Who works.
        root: First part of every key.
        listed_s: When the bucket was listed last, by the ledger's clock; None: not yet.

    Raises:
        StoreUnavailableError: If the database does not answer now.
    """
    backlog = ledger.backlog()
    return {
        "scenes": backlog.current_scenes,
        "logs": sum(backlog.recordings.values()),
        "logs_waiting": backlog.recordings.get("waiting", 0),
        "logs_growing": backlog.recordings.get("settling", 0),
        "shards_done": backlog.work.get(("shard", WorkState.DONE), 0),
        "shards_waiting": backlog.work.get(("shard", WorkState.READY), 0),
        "shards_leased": backlog.work.get(("shard", WorkState.LEASED), 0),
        "parked": sum(backlog.work.get((kind, WorkState.PARKED), 0) for kind in ("plan", "shard")),
        "workers": workers_alive(session, root=root),
        "listed_ago_s": None if listed_s is None else round(ledger.now_s() - listed_s),
    }


def workers_alive(session: zenoh.Session, *, root: str) -> int:
    """Count the workers that the bus knows to live now, wherever they run."""
    found = session.liveliness().get(keys.all_live(root=root, role="worker"), timeout=5)
    return sum(reply.ok is not None for reply in found)
