"""Entries of the bucket that the last listing skipped, for `status`."""

from sqlalchemy import Connection, delete, insert, select

from service.curation.status import SkippedEntries, SkippedEntry
from service.store.tables import SKIPPED_ENTRIES


def note_skipped(connection: Connection, skipped: SkippedEntries) -> None:
    """Replace what the listing before skipped."""
    connection.execute(delete(SKIPPED_ENTRIES))
    last = len(skipped.named) - 1
    rows = [
        {
            "position": position,
            "name": each.name,
            "why": each.why,
            "others": skipped.count - len(skipped.named) if position == last else 0,
        }
        for position, each in enumerate(skipped.named)
    ]
    if rows:
        connection.execute(insert(SKIPPED_ENTRIES), rows)


def skipped_entries(connection: Connection) -> SkippedEntries:
    """Read what the last listing skipped."""
    rows = connection.execute(select(SKIPPED_ENTRIES).order_by(SKIPPED_ENTRIES.c.position)).all()
    return SkippedEntries(
        count=len(rows) + sum(row.others for row in rows),
        named=tuple(SkippedEntry(name=row.name, why=row.why) for row in rows),
    )
