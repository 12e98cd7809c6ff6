"""Audit log: who selected, judged, retried and exported what, and when.

A row is written in the transaction of what it reports, so a killed process leaves both or neither.
Each row has a digest over itself and the row before it, so a row that was changed or deleted
afterwards breaks the chain.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Final, Literal

from sqlalchemy import Connection, insert, select, update

from schemas.canonical import canonical_json, sha256
from service.curation.audit import AuditRequest, AuditRow, ExportedRequest
from service.curation.status import ParkedWork
from service.store.engine import Store
from service.store.tables import AUDIT, COUNTERS

Via = Literal["bus", "command"]
"""Way on which a request came: over the bus to a service, or by a command on the state."""

MAX_DETAIL: Final = 4000
"""Characters of the details of one row; longer lists are cut, and their length is stated."""

MOST_LISTED: Final = 50
"""Scenes or logs that a row names."""


@dataclass(frozen=True, slots=True)
class Actor:
    """A person or program that asks.

    Attributes:
        name: Name by a certificate, from the key of the request; empty: nothing proves who it is.
        says: Name that the asker gives itself, such as the user of a command or of the page.
        via: Way on which the request came.
    """

    name: str = ""
    says: str = ""
    via: Via = "command"


_ACTOR: Final[ContextVar[Actor | None]] = ContextVar("actor", default=None)


@contextmanager
def acting(actor: Actor) -> Iterator[None]:
    """State who asks for what is written within the block."""
    token = _ACTOR.set(actor)
    try:
        yield
    finally:
        _ACTOR.reset(token)


def actor() -> Actor:
    """Return who asks."""
    return _ACTOR.get() or Actor()


class AuditLog:
    """Audit log of one store: read, and written to where nothing else is stored."""

    def __init__(self, store: Store, *, now_s: Callable[[], float]) -> None:
        """Keep the store and the clock for what is durable, seconds."""
        self._store, self._now_s = store, now_s

    def exported(self, request: ExportedRequest) -> int:
        """Note an export; return the number of its row."""
        now_s, who = self._now_s(), actor()
        with self._store.writing() as connection:
            return record(connection, who, "export", request.model_dump(), now_s=now_s)

    def page(self, request: AuditRequest) -> list[AuditRow]:
        """Return a page of rows, latest first."""
        with self._store.reading() as connection:
            return page(connection, before=request.before, most=request.most)


def record(
    connection: Connection, who: Actor, what: str, detail: Mapping[str, Any], *, now_s: float
) -> int:
    """Append a row to the audit log, in the transaction of what it reports; return its number.

    Args:
        connection: In a transaction that writes.
        who: Who asked; read before the transaction, which another thread may lead.
        what: The verb.
        detail: What was done, as JSON.
        now_s: Time, seconds since the Unix epoch.
    """
    ordinal = int(
        connection.execute(
            update(COUNTERS)
            .where(COUNTERS.c.name == "audit")
            .values(value=COUNTERS.c.value + 1)
            .returning(COUNTERS.c.value)
        ).scalar_one()
    )
    before = connection.execute(
        select(AUDIT.c.digest).where(AUDIT.c.ordinal == ordinal - 1)
    ).scalar_one_or_none()
    row = AuditRow(
        ordinal=ordinal,
        at_s=now_s,
        name=who.name,
        says=who.says,
        via=who.via,
        what=what,
        detail=json.dumps(detail)[:MAX_DETAIL],
    )
    values = row.model_dump(exclude={"is_whole"})
    connection.execute(insert(AUDIT).values(**values, digest=_digest(before or "", row)))
    return ordinal


def retried(connection: Connection, works: Sequence[ParkedWork], *, now_s: float) -> None:
    """Append a row about work that is retried; the thread that asks leads the transaction."""
    names = [f"{each.log_id} {each.shard}".rstrip() for each in works]
    record(connection, actor(), "retry", few(names), now_s=now_s)


def few(names: Sequence[str]) -> dict[str, Any]:
    """Return the number of names, and the first of them."""
    return {"count": len(names), "first": list(names[:MOST_LISTED])}


def page(connection: Connection, *, before: int | None, most: int) -> list[AuditRow]:
    """Return rows of the audit log, latest first.

    A row is not whole if it or the row before it was changed or deleted after it was written.
    """
    query = select(AUDIT).order_by(AUDIT.c.ordinal.desc()).limit(most + 1)
    if before is not None:
        query = query.where(AUDIT.c.ordinal < before)
    stored = connection.execute(query).all()
    rows = []
    for position, found in enumerate(stored[:most]):
        row = AuditRow(**{name: getattr(found, name) for name in _COLUMNS})
        earlier = stored[position + 1] if position + 1 < len(stored) else None
        follows = earlier is None or earlier.ordinal == row.ordinal - 1
        starts = earlier is not None or row.ordinal == 1
        digest = "" if earlier is None else earlier.digest
        whole = follows and starts and found.digest == _digest(digest, row)
        rows.append(row.model_copy(update={"is_whole": whole}))
    return rows


_COLUMNS: Final = ("ordinal", "at_s", "name", "says", "via", "what", "detail")


def _digest(before: str, row: AuditRow) -> str:
    return sha256(before.encode() + canonical_json(row.model_dump(exclude={"is_whole"})))
