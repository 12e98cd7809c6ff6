"""Lineage of a database: its id, a count of its writes, and the term of the service that writes.

A database that is dropped, replaced, or restored from an older copy under a running service would
issue numbers a second time. One row, which every write increments, makes that visible. The row also
fences writers: each opening for writing raises the term, and since both update the same row, no
transaction of an earlier term can end after it.
"""

import uuid
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, bindparam, select, text, update

from service.errors import DatabaseTakenError, StateUnusableError
from service.store.statements import Statement
from service.store.tables import WRITE_PROOF

RESTORED: Final = (
    "{name} is no longer the database that this service wrote: {what}; nothing is acknowledged any "
    "more: when it is restored, start the service again on it; what was written since that copy is "
    "mined again, and subscribers begin with 0"
)


@dataclass(frozen=True, slots=True)
class Lineage:
    """Identity of a database, and its count of writes.

    Attributes:
        incarnation: Random id, assigned when its tables were made.
        writes: Transactions that changed something.
        term: Number of openings for writing; the newest one may write.
    """

    incarnation: str
    writes: int
    term: int = 0

    def require_not_before(self, known: "Lineage | None", *, name: str) -> "Lineage":
        """Check that this is a later state of the same database.

        Args:
            known: Last known lineage; None: none.
            name: Name of the database, for the message.

        Returns:
            This.

        Raises:
            StateUnusableError: If it is another database, or an earlier state of it.
            DatabaseTakenError: If another service has opened it for writing.
        """
        if known is None:
            return self
        if self.incarnation != known.incarnation:
            what = "another one has replaced it"
        elif self.writes < known.writes:
            what = f"it has gone back from write {known.writes} to write {self.writes}"
        elif self.term > known.term:
            raise DatabaseTakenError(
                f"another service serves this database now, under term {self.term}; this one has "
                f"term {known.term} and acknowledges nothing any more ({name}); stop one of the "
                "two, or start both with --standby"
            )
        else:
            return self
        raise StateUnusableError(RESTORED.format(name=name, what=what))


def give_incarnation(connection: Connection) -> None:
    """Assign an id to a database without one: a new one, or one of an earlier version."""
    _NAME.rows(connection, {"new": uuid.uuid4().hex})


def take_term(connection: Connection) -> None:
    """Begin a new term: transactions of every earlier one are refused from its commit on."""
    _TAKE.rows(connection, {})


def read_lineage(connection: Connection, name: str) -> Lineage:
    """Read the lineage of a database.

    Args:
        connection: In a transaction.
        name: Which database, for the message.

    Raises:
        StateUnusableError: If its table is empty: another program empties or restores the database.
    """
    row = _READ.first(connection, {})
    if row is None:
        raise StateUnusableError(RESTORED.format(name=name, what="its tables were emptied"))
    return Lineage(row.incarnation, row.writes, row.term)


def count_write(connection: Connection, *, changed_before: int, always: bool) -> Lineage | None:
    """Count the transaction of this connection, if it changed anything.

    Args:
        connection: At the end of a transaction that writes.
        changed_before: Result of `changes` at its beginning.
        always: Count it in any case.

    Returns:
        Lineage including this transaction; None if it was not counted.
    """
    if connection.dialect.name == "sqlite":
        counts = always or changes(connection) != changed_before
        row = _COUNT.one(connection, {}) if counts else None
    else:
        row = (_COUNT if always else _COUNT_IF_CHANGED).first(connection, {})
    return None if row is None else Lineage(row.incarnation, row.writes, row.term)


def changes(connection: Connection) -> int:
    """Return the rows that this SQLite connection has changed since it was opened; 0 elsewhere."""
    driver: Any = connection.connection.driver_connection
    return int(getattr(driver, "total_changes", 0))


_C: Final = WRITE_PROOF.c
_READ: Final = Statement(select(_C.incarnation, _C.writes, _C.term))
_TAKE: Final = Statement(update(WRITE_PROOF).values(term=_C.term + 1))
_NAME: Final = Statement(
    update(WRITE_PROOF).where(_C.incarnation == "").values(incarnation=bindparam("new"))
)
_COUNTING: Final = (
    update(WRITE_PROOF).values(writes=_C.writes + 1).returning(_C.incarnation, _C.writes, _C.term)
)
_COUNT: Final = Statement(_COUNTING)
_COUNT_IF_CHANGED: Final = Statement(
    _COUNTING.where(text("txid_current_if_assigned() IS NOT NULL"))
)
"""Condition on the id of a transaction, which PostgreSQL assigns at its first change or lock."""
