"""Lease of a PostgreSQL database by its service: the sign of life that a standby watches.

A killed service frees its lock at once, since its connection ends. A frozen one keeps connection
and lock, so that only its missing beats show that it serves no longer. The beats are counted, and
each side measures silence by its own monotonic clock: no two clocks are compared.
"""

from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection, text
from sqlalchemy.exc import ProgrammingError

LOCK: Final = 0x436E7470
"""First half of PostgreSQL's lock key, of this program; the second is the schema's name."""

STANDBY: Final = "counterpoint standby"
"""Name of the session by which a standby looks."""

TAKE: Final = text("SELECT pg_try_advisory_lock(:lock, hashtext(current_schema()))")
_HELD: Final = text(
    "SELECT pid FROM pg_locks WHERE locktype = 'advisory' AND classid = :lock AND granted"
    " AND objid::bigint = (hashtext(current_schema())::bigint & 4294967295)"
    " AND pg_locks.database = (SELECT oid FROM pg_database WHERE datname = current_database())"
)
_NAMED: Final = text(
    "SELECT application_name, coalesce(host(client_addr), 'a socket')"
    " FROM pg_stat_activity WHERE pid = :pid"
)
_STANDBYS: Final = text(
    "SELECT count(*) FROM pg_stat_activity"
    " WHERE datname = current_database() AND application_name = :name"
)
_LOOK: Final = text("SELECT beats, lease_s FROM service_lease")
_BEAT: Final = text(
    "UPDATE service_lease SET beats = beats + 1, lease_s = :lease_s"
    " WHERE (SELECT term FROM write_proof) = :term RETURNING beats"
)
_END_HOLDER: Final = text(
    """
    SELECT pg_terminate_backend(theirs.pid)
    FROM pg_stat_activity AS holder
    JOIN pg_stat_activity AS theirs ON theirs.pid = holder.pid OR (
        theirs.application_name LIKE 'counterpoint-%'
        AND split_part(theirs.application_name, ' ', 1)
            = split_part(holder.application_name, ' ', 1)
    )
    WHERE holder.pid = :pid AND (SELECT beats FROM service_lease) = :beats
    """
)
"""Ends all sessions of a silent holder: a frozen transaction would keep its row locks for ever."""


@dataclass(frozen=True, slots=True)
class LeaseSeen:
    """State of the lease at one look.

    Attributes:
        holder: Session that holds the lock; None: it is free.
        beats: Beats so far; None: the database has no lease yet.
        lease_s: Silence after which the holder counts as frozen, seconds; 0: it has not beaten.
    """

    holder: int | None
    beats: int | None
    lease_s: float


def look(connection: Connection) -> LeaseSeen:
    """Read the lease, outside of a transaction."""
    holder = connection.execute(_HELD, {"lock": LOCK}).scalar()
    try:
        beats, lease_s = connection.execute(_LOOK).one()
    except ProgrammingError:  # empty, or of a version without a lease
        return LeaseSeen(holder, None, 0.0)
    return LeaseSeen(holder, beats, lease_s)


def beat(connection: Connection, *, term: int, lease_s: float) -> bool:
    """Give a sign of life; return false if another term has begun."""
    try:
        return connection.execute(_BEAT, {"term": term, "lease_s": lease_s}).first() is not None
    except ProgrammingError:  # its tables are gone, which the store reports
        return True


def standbys(connection: Connection) -> int:
    """Count the services that stand by for this database."""
    return int(connection.execute(_STANDBYS, {"name": STANDBY}).scalar_one())


def end_holder(connection: Connection, seen: LeaseSeen) -> int:
    """End all sessions of the holder if it has not beaten since this look; return how many."""
    asked = {"pid": seen.holder, "beats": seen.beats}
    return sum(map(bool, connection.execute(_END_HOLDER, asked).scalars()))


def named_holder(connection: Connection) -> tuple[str, str]:
    """Return the name of the session that holds the lock, and its address."""
    pid = connection.execute(_HELD, {"lock": LOCK}).scalar()
    row = connection.execute(_NAMED, {"pid": pid}).first()
    return ("", "an unknown address") if row is None else (str(row[0]), str(row[1]))
