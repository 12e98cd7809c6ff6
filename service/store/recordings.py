"""What lies in the bucket, as the ledger knows it: listings come in, work and scenes follow."""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import (
    ColumnElement,
    Connection,
    Table,
    and_,
    exists,
    func,
    insert,
    literal,
    select,
    update,
)

from schemas.work import Recording
from service.store.events import restore, withdraw
from service.store.tables import LEASES, PIPELINES, PLANS, RECORDINGS, SCENES, SHARDS
from service.store.work import OPEN, WorkState


@dataclass(frozen=True, slots=True)
class SyncResult:
    """Log ids that a listing added, replaced and removed."""

    new: tuple[str, ...] = ()
    replaced: tuple[str, ...] = ()
    deleted: tuple[str, ...] = ()


def sync_recordings(connection: Connection, recordings: Sequence[Recording]) -> SyncResult:
    """Make the current recordings those of a complete listing.

    A recording of another revision supersedes the old one: open work on that is cancelled and its
    scenes are withdrawn; all of it is kept, and comes back if that revision does.

    Raises:
        ValueError: If two recordings have one log id.
    """
    listed = {recording.log_id: recording for recording in recordings}
    if len(listed) != len(recordings):
        raise ValueError("a listing names one log twice; log ids must be unique in the bucket")
    known = {
        row.log_id: row.revision
        for row in connection.execute(
            select(RECORDINGS.c.log_id, RECORDINGS.c.revision).where(RECORDINGS.c.is_current)
        )
    }
    new = sorted(listed.keys() - known.keys())
    deleted = sorted(known.keys() - listed.keys())
    replaced = sorted(
        log_id
        for log_id in listed.keys() & known.keys()
        if listed[log_id].revision != known[log_id]
    )
    for log_id in (*deleted, *replaced):
        _retire(connection, log_id=log_id, revision=known[log_id])
    for log_id in (*new, *replaced):
        _enter(connection, listed[log_id])
    _take_up_stale(connection)
    return SyncResult(tuple(new), tuple(replaced), tuple(deleted))


def stale_logs(connection: Connection) -> list[str]:
    """Logs whose object changed under a reader, since the last listing."""
    plans, shards = (select(table.c.log_id).where(_is_stale(table)) for table in (PLANS, SHARDS))
    return sorted(connection.execute(plans.union(shards)).scalars())


def register_pipeline(connection: Connection, pipeline_version: str) -> None:
    """Note a pipeline version; of several, the one first seen last is the newest."""
    known = select(PIPELINES.c.ordinal).where(PIPELINES.c.pipeline_version == pipeline_version)
    if connection.execute(known).one_or_none() is None:
        newest = connection.execute(select(func.max(PIPELINES.c.ordinal))).scalar_one() or 0
        connection.execute(
            insert(PIPELINES).values(pipeline_version=pipeline_version, ordinal=newest + 1)
        )


def seed_plans(connection: Connection, pipeline_version: str) -> None:
    """Give every current recording a plan to be made under this pipeline version."""
    has_plan = exists().where(
        PLANS.c.log_id == RECORDINGS.c.log_id,
        PLANS.c.revision == RECORDINGS.c.revision,
        PLANS.c.pipeline_version == pipeline_version,
    )
    values = {
        "log_id": RECORDINGS.c.log_id,
        "revision": RECORDINGS.c.revision,
        "pipeline_version": literal(pipeline_version),
        "state": literal(WorkState.READY.value),
        "attempts": literal(0),
        "error": literal(""),
        "ready_at_s": literal(0.0),
        "lease_id": literal(""),
        "vehicle": literal("unknown"),
        "date": literal("unknown"),
        "software_version": literal("unknown"),
        "lidar_topics": literal("[]"),
        "digest": literal(""),
        "range_reads": literal(0),
        "bytes_read": literal(0),
    }
    connection.execute(
        insert(PLANS).from_select(
            list(values), select(*values.values()).where(RECORDINGS.c.is_current, ~has_plan)
        )
    )


def _retire(connection: Connection, *, log_id: str, revision: str) -> None:
    """End a revision: its open work is cancelled, its scenes are history."""
    connection.execute(
        update(RECORDINGS)
        .where(RECORDINGS.c.log_id == log_id, RECORDINGS.c.revision == revision)
        .values(is_current=False)
    )
    for table in (PLANS, SHARDS):
        connection.execute(
            update(table)
            .where(
                table.c.log_id == log_id,
                table.c.revision == revision,
                table.c.state.in_(OPEN),
            )
            .values(state=WorkState.CANCELLED, lease_id="")
        )
    connection.execute(
        update(LEASES)
        .where(LEASES.c.is_held, LEASES.c.log_id == log_id, LEASES.c.revision == revision)
        .values(is_held=False, ended_by="replaced")
    )
    withdraw(
        connection,
        and_(SCENES.c.log_id == log_id, SCENES.c.revision == revision),
        by="revision",
    )


def _enter(connection: Connection, recording: Recording) -> None:
    """Make a revision the current one of its log; one that was known before is taken up again."""
    key = and_(RECORDINGS.c.log_id == recording.log_id, RECORDINGS.c.revision == recording.revision)
    back = connection.execute(
        update(RECORDINGS).where(key).values(is_current=True).returning(RECORDINGS.c.log_id)
    ).one_or_none()
    if back is None:
        connection.execute(
            insert(RECORDINGS).values(
                log_id=recording.log_id,
                revision=recording.revision,
                recording=recording.model_dump_json(),
                is_current=True,
            )
        )
        return
    for table in (PLANS, SHARDS):
        connection.execute(
            update(table)
            .where(
                table.c.log_id == recording.log_id,
                table.c.revision == recording.revision,
                table.c.state == WorkState.CANCELLED,
            )
            .values(state=WorkState.READY, ready_at_s=0.0)
        )
    restore(connection, log_id=recording.log_id, revision=recording.revision)


def _take_up_stale(connection: Connection) -> None:
    """Try again what was seen to change but is listed as it was: the reader met a passing state."""
    for table in (PLANS, SHARDS):
        connection.execute(update(table).where(_is_stale(table)).values(state=WorkState.READY))


def _is_stale(table: Table) -> ColumnElement[bool]:
    # Naming every pipeline version lets both servers use the index that begins with it.
    every = select(PIPELINES.c.pipeline_version)
    return and_(table.c.pipeline_version.in_(every), table.c.state == WorkState.STALE.value)
