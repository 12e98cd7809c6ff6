"""Check that a state is used with its own bucket, which may move to another URL."""

from collections.abc import Sequence
from typing import Final

from sqlalchemy import Connection, delete, insert, select

from schemas.work import Recording
from service.errors import OtherBucketError
from service.store.tables import RECORDINGS, SERVED_BUCKET

LEAST_SHARE: Final = 0.5
"""Share of its logs that a bucket still has after a move, at least; some may have been deleted."""


def served_bucket(connection: Connection) -> str:
    """Return the URL of the bucket this state belongs to; empty: of none so far."""
    return connection.execute(select(SERVED_BUCKET.c.url)).scalar_one_or_none() or ""


def require_served(
    connection: Connection, url: str, listed: Sequence[Recording], *, name: str
) -> bool:
    """Check that a bucket is the one that this state belongs to.

    A bucket at the same URL is. One at another URL is accepted if it has at least half of the logs,
    by key and size, since copies have etags of their own. A state without logs accepts any.

    Args:
        connection: In a transaction.
        url: URL of the bucket.
        listed: All logs in it.
        name: Name of the database, for the message.

    Returns:
        True if the URL is the recorded one.

    Raises:
        OtherBucketError: If it is another bucket.
    """
    before = served_bucket(connection)
    if not before or before == url:
        return before == url
    stored = connection.execute(select(RECORDINGS.c.recording).where(RECORDINGS.c.is_current))
    known = {_contents(Recording.model_validate_json(row)) for row in stored.scalars()}
    found = len(known & {_contents(each) for each in listed})
    if found < LEAST_SHARE * len(known):
        raise OtherBucketError(
            f"this state belongs to {before}: of its {len(known)} logs {url} holds {found}, and "
            f"the scenes of the others would be taken back ({name}); name another folder with "
            "--state, or another --database, for this bucket"
        )
    return False


def note_served(connection: Connection, url: str) -> None:
    """Record the URL of the bucket."""
    connection.execute(delete(SERVED_BUCKET))
    connection.execute(insert(SERVED_BUCKET).values(url=url))


def _contents(recording: Recording) -> tuple[tuple[str, int], ...]:
    return tuple((part.key, part.size) for part in recording.parts)
