"""Heartbeat in the log: rare lines of an idle daemon, progress each minute of a busy one."""

import math
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
"""Interval of the checks for a due line, seconds."""

BUSY_S: Final = 60.0
"""Interval of lines while something changes, seconds; one line sums up all changes."""

WORK: Final = ("logs_waiting", "logs_growing", "shards_waiting", "shards_leased")
"""Names of pending work; a daemon with any of it is not idle, even if a slow shard takes long."""

Standing: TypeAlias = Mapping[str, int | float | None]
"""State of a daemon by name; values in `_s` grow by themselves and count as no change."""


class Heartbeat:
    """Logs the state of a daemon: rarely while nothing changes, else each minute."""

    def __init__(
        self,
        standing: Callable[[], Standing],
        *,
        heartbeat_s: float,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start counting.

        Args:
            standing: Returns the state; called only when a line may be due.
            heartbeat_s: Longest silence, seconds.
            clock_s: Monotonic seconds.
        """
        self._standing, self._heartbeat_s, self._clock_s = standing, heartbeat_s, clock_s
        self._said_at_s = clock_s()
        self._said: Standing | None = None

    @property
    def interval_s(self) -> float:
        """Interval at which `beat` is to be called, seconds."""
        return min(LOOK_S, self._heartbeat_s)

    def beat(self) -> None:
        """Log the state, if a line is due."""
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
    ledger: Ledger, session: zenoh.Session, *, root: str, listed_ago_s: float
) -> Standing:
    """Return the state of a service: logs, waiting work, live workers, age of the last listing.

    Args:
        ledger: Source of logs and work.
        session: Source of the workers alive.
        root: First part of every key.
        listed_ago_s: Time since the last listing, seconds; infinite before the first.

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
        "listed_ago_s": round(listed_ago_s) if math.isfinite(listed_ago_s) else None,
    }


def workers_alive(session: zenoh.Session, *, root: str) -> int:
    """Count the workers with a liveliness token on the bus, on any machine."""
    found = session.liveliness().get(keys.all_live(root=root, role="worker"), timeout=5)
    return sum(reply.ok is not None for reply in found)
