"""A glance at the ledger of a day, beside its service and also while there is none."""

from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import select

from service.curation.status import LogStatus
from service.store import overview
from service.store.engine import Store, open_store_to_read
from service.store.tables import RECORDINGS
from tests.integration.bucket_day import After


@dataclass(frozen=True, slots=True)
class Seen:
    """The ledger at one moment.

    Attributes:
        revisions: Log id to the revision that the last listing found.
        logs: Log id to how far it is.
    """

    revisions: dict[str, str]
    logs: dict[str, LogStatus]

    def has_come_to(self, after: After, log_id: str, *, revision: str | None) -> bool:
        """Whether the service has come so far with this revision of a log; None: it is gone."""
        if after == "nothing":
            return True
        if self.revisions.get(log_id) != revision:
            return False
        if after == "listed":
            return True
        log = self.logs[log_id]
        return log.state == "done" or (after == "leased" and bool(log.shards.get("leased")))


class Glance:
    """Reads a state, opened at the first look."""

    def __init__(self, state: Path) -> None:
        self._state = state
        self._store: Store | None = None

    def look(self) -> Seen:
        """See how far everything is; the service has answered once."""
        if self._store is None:
            self._store = open_store_to_read(self._state)
        with self._store.reading() as connection:
            current = select(RECORDINGS.c.log_id, RECORDINGS.c.revision).where(
                RECORDINGS.c.is_current
            )
            revisions = {row.log_id: row.revision for row in connection.execute(current)}
            status = overview.status(connection, None, now_s=0.0)
        return Seen(revisions, {log.log_id: log for log in status.logs})

    def sees_mining(self) -> bool:
        """Whether a shard is being mined."""
        return any(log.shards.get("leased") for log in self.look().logs.values())

    def close(self) -> None:
        if self._store is not None:
            self._store.close()
