"""Entries of the bucket that the last listing skipped, for `status`."""

from sqlalchemy import Connection, delete, insert, select, update

from service.curation.status import SkippedEntries, SkippedEntry
from service.store.tables import COUNTERS, SKIPPED_ENTRIES

_COUNT = COUNTERS.c.name == "skipped"


def note_skipped(connection: Connection, skipped: SkippedEntries) -> None:
    """Replace what the listing before skipped."""
    connection.execute(update(COUNTERS).where(_COUNT).values(value=skipped.count))
    connection.execute(delete(SKIPPED_ENTRIES))
    rows = [
        {"position": position, "name": each.name, "why": each.why}
        for position, each in enumerate(skipped.named)
    ]
    if rows:
        connection.execute(insert(SKIPPED_ENTRIES), rows)


def skipped_entries(connection: Connection) -> SkippedEntries:
    """Read what the last listing skipped."""
    rows = connection.execute(select(SKIPPED_ENTRIES).order_by(SKIPPED_ENTRIES.c.position))
    return SkippedEntries(
        count=connection.execute(select(COUNTERS.c.value).where(_COUNT)).scalar_one(),
        named=tuple(SkippedEntry(name=row.name, why=row.why) for row in rows),
    )
