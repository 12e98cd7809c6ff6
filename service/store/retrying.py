"""Retry of parked work and of refused logs on request, after the cause is fixed."""

from collections.abc import Collection, Sequence
from typing import Any

from sqlalchemy import Connection, Table, and_, delete, select

from service.curation.status import ParkedWork
from service.errors import NothingFoundError
from service.store.overview import newest_pipeline
from service.store.retirement import without_overlays
from service.store.tables import DAMAGE, PLANS, RECORDINGS, SHARDS
from service.store.transaction_effects import effects_of, kind_of
from service.store.work_items import Work, WorkState, change
from service.store.worker_deaths import pardon

OVERLAYS_DELETED = "its overlays were deleted to keep the disk budget"

MOST_NAMED = 5
"""Unknown logs named in one sentence."""


def retry(
    connection: Connection, log_ids: Sequence[str] | None, *, refused: bool = False
) -> list[ParkedWork]:
    """Make parked work, or the plans of refused logs, ready again; the error is kept.

    It applies to current recordings under the newest pipeline version, as listed by `status`. Of
    named logs both are, and shards whose overlays were deleted are mined again too.

    Args:
        connection: In a transaction that writes.
        log_ids: Only work of these logs; None: of all.
        refused: Without names, plan refused logs again in place of parked work.

    Returns:
        Work that was parked or refused, in the order of log and shard.

    Raises:
        NothingFoundError: If one of these logs is not in the bucket.
    """
    if log_ids is not None:
        _refuse_unknown(connection, log_ids)
    version = newest_pipeline(connection)
    retried = []
    states = {WorkState.REFUSED if refused else WorkState.PARKED}
    if log_ids is not None:
        states = {WorkState.PARKED, WorkState.REFUSED}
    for table in (PLANS, SHARDS):
        for row in _ended(connection, table, version, states):
            if log_ids is not None and row.log_id not in log_ids:
                continue
            shard = row.name if table is SHARDS else ""
            work = Work(row.log_id, row.revision, version, shard)
            change(connection, work, state=WorkState.READY, attempts=0, ready_at_s=0.0)
            pardon(connection, work)
            if row.state == WorkState.REFUSED:  # its next plan stores its own
                _forget_damage(connection, work)
            effects_of(connection).retried[kind_of(shard)] += 1
            retried.append(
                ParkedWork(log_id=row.log_id, shard=shard, attempts=row.attempts, error=row.error)
            )
    for work in without_overlays(connection, log_ids or ()):
        change(connection, work, state=WorkState.READY, attempts=0, ready_at_s=0.0, error="")
        effects_of(connection).retried[kind_of(work.shard)] += 1
        retried.append(
            ParkedWork(log_id=work.log_id, shard=work.shard, attempts=0, error=OVERLAYS_DELETED)
        )
    return sorted(retried, key=lambda work: (work.log_id, work.shard))


def _ended(
    connection: Connection, table: Table, version: str, states: Collection[WorkState]
) -> Sequence[Any]:
    """Return rows of such work of current recordings, locked against concurrent retries."""
    same_log = and_(
        table.c.log_id == RECORDINGS.c.log_id, table.c.revision == RECORDINGS.c.revision
    )
    return connection.execute(
        select(*table.primary_key.columns, table.c.state, table.c.attempts, table.c.error)
        .join(RECORDINGS, same_log)
        .where(
            table.c.pipeline_version == version,
            table.c.state.in_(states),
            RECORDINGS.c.is_current,
        )
        .with_for_update(of=table)
    ).all()


def _forget_damage(connection: Connection, work: Work) -> None:
    connection.execute(
        delete(DAMAGE).where(
            DAMAGE.c.log_id == work.log_id,
            DAMAGE.c.revision == work.revision,
            DAMAGE.c.pipeline_version == work.pipeline_version,
            DAMAGE.c.shard == work.shard,
        )
    )


def _refuse_unknown(connection: Connection, log_ids: Sequence[str]) -> None:
    current = select(RECORDINGS.c.log_id).where(RECORDINGS.c.is_current)
    unknown = sorted(set(log_ids) - set(connection.execute(current).scalars()))
    if unknown:
        named = ", ".join(map(repr, unknown[:MOST_NAMED]))
        more = f" and {len(unknown) - MOST_NAMED} more" if len(unknown) > MOST_NAMED else ""
        raise NothingFoundError(
            f"no such log in the bucket: {named}{more}; `counterpoint status` lists them, "
            "and nothing was changed"
        )
