"""Work items of leases: the plan of a log or one of its shards, and their states."""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, Row, Table, and_, bindparam, select, update

from service.store.statements import Statement
from service.store.tables import PLANS, SHARDS


class WorkState(StrEnum):
    """State of a plan or a shard.

    The normal order is ready -> leased -> done (a plan may end refused instead). A lease that ends
    badly leads back to ready, and finally to parked. Work that is stale waits for the next listing
    of the bucket, cancelled work for its revision to return. Kept work is left out by `remine`: the
    scenes of an earlier pipeline version stay. Another log is mined in place of the same work, of
    the same bytes.
    """

    READY = "ready"
    LEASED = "leased"
    DONE = "done"
    REFUSED = "refused"
    PARKED = "parked"
    STALE = "stale"
    CANCELLED = "cancelled"
    KEPT = "kept"
    SAME = "same"


TAKEN_AND_GIVEN: Final = (
    "digest",
    "committed_s",
    "frames",
    "points",
    "bytes_read",
    "bytes_needed",
    "range_reads",
    "peak_memory_bytes",
    "stage_s",
)
"""Columns with cost and results of mining, set at a shard's commit and copied at its adoption."""

OPEN: Final = (WorkState.READY, WorkState.LEASED, WorkState.STALE)
"""States in which work is still to be done."""


@dataclass(frozen=True, slots=True)
class Work:
    """One plan (`shard` empty) or one shard, by its key in the ledger."""

    log_id: str
    revision: str
    pipeline_version: str
    shard: str = ""

    def __str__(self) -> str:
        """Return the name in messages."""
        what = f"shard {self.shard}" if self.shard else "the plan"
        return f"{what} of {self.log_id}"


def row_of(connection: Connection, work: Work) -> Row[Any]:
    """Read the row of a plan or shard, locked against other writers."""
    row: Row[Any] = _SELECT[bool(work.shard)].one(connection, _key(work))
    return row


def change(connection: Connection, work: Work, **values: Any) -> None:
    """Set columns of a plan or shard."""
    _update(bool(work.shard), tuple(values)).rows(connection, {**_key(work), **values})


def _key(work: Work) -> dict[str, str]:
    key = {
        "at_log": work.log_id,
        "at_revision": work.revision,
        "at_pipeline": work.pipeline_version,
    }
    return {**key, "at_shard": work.shard} if work.shard else key


def _at(table: Table) -> ColumnElement[bool]:
    found = and_(
        table.c.log_id == bindparam("at_log"),
        table.c.revision == bindparam("at_revision"),
        table.c.pipeline_version == bindparam("at_pipeline"),
    )
    return and_(found, SHARDS.c.name == bindparam("at_shard")) if table is SHARDS else found


# Built once: to build a statement costs more than to run it.
_TABLES: Final = {False: PLANS, True: SHARDS}
_SELECT: Final = {
    is_shard: Statement(select(table).where(_at(table)).with_for_update())
    for is_shard, table in _TABLES.items()
}


@cache
def _update(is_shard: bool, columns: tuple[str, ...]) -> Statement:
    """Return a cached update of these columns; there are as many sets of them as callers."""
    table = _TABLES[is_shard]
    values: dict[str, Any] = {column: bindparam(column) for column in columns}
    return Statement(update(table).where(_at(table)).values(**values))
