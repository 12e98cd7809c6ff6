"""Recordings in the ledger: applies listings of the bucket, and updates work and scenes."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    Table,
    and_,
    bindparam,
    delete,
    insert,
    or_,
    select,
    update,
)

from schemas.work import Layers, Recording
from service.store.events import withdraw
from service.store.leases import end_lease
from service.store.reused_shards import enter_again
from service.store.same_bytes import content_digest, share_bytes
from service.store.tables import LEASES, PIPELINES, PLANS, RECORDINGS, SCENES, SHARDS
from service.store.work_items import OPEN, WorkState


@dataclass(frozen=True, slots=True)
class Listed:
    """A listed recording, and its revision, which takes a while to compute."""

    recording: Recording
    revision: str


@dataclass(frozen=True, slots=True)
class SyncResult:
    """Log ids that a listing added, replaced and removed."""

    new: tuple[str, ...] = ()
    replaced: tuple[str, ...] = ()
    deleted: tuple[str, ...] = ()


def by_log(recordings: Sequence[Recording]) -> dict[str, Listed]:
    """Index a listing by log id, its revisions computed. Pure, so that the transaction is short.

    Raises:
        ValueError: If two recordings have one log id.
    """
    listed = {each.log_id: Listed(each, each.revision) for each in recordings}
    if len(listed) != len(recordings):
        raise ValueError("a listing names one log twice; log ids must be unique in the bucket")
    return listed


def sync_recordings(
    connection: Connection,
    listed: Mapping[str, Listed],
    *,
    now_s: float,
    among: Collection[str] | None = None,
) -> SyncResult:
    """Make the current recordings those of a complete listing.

    Open work on a recording that was replaced or deleted is cancelled. Scenes of a deleted one are
    withdrawn at once. Those of a replaced one stay until the plan of the new revision is finished,
    refused or parked. All of it is kept, and is restored if that revision returns.

    Args:
        connection: In a transaction that writes.
        listed: All recordings of the bucket, or those of `among`.
        now_s: Time of the listing by the service's clock, seconds.
        among: Logs that are listed; None: all.
    """
    current = select(RECORDINGS.c.log_id, RECORDINGS.c.revision).where(RECORDINGS.c.is_current)
    if among is not None:
        current = current.where(RECORDINGS.c.log_id.in_(among))
    known = {row.log_id: row.revision for row in connection.execute(current)}
    new = sorted(listed.keys() - known.keys())
    deleted = sorted(known.keys() - listed.keys())
    replaced = sorted(
        log_id
        for log_id in listed.keys() & known.keys()
        if listed[log_id].revision != known[log_id]
    )
    _retire(connection, {log_id: known[log_id] for log_id in (*deleted, *replaced)})
    _enter_all(connection, [listed[log_id] for log_id in (*new, *replaced)], now_s=now_s)
    if deleted and among is not None:
        withdraw(connection, SCENES.c.log_id.in_(deleted), by="revision")
    elif deleted:
        existing = select(RECORDINGS.c.log_id).where(RECORDINGS.c.is_current)
        withdraw(connection, SCENES.c.log_id.not_in(existing), by="revision")
    share_bytes(connection)
    _take_up_stale(connection)
    return SyncResult(tuple(new), tuple(replaced), tuple(deleted))


def has_recordings(connection: Connection) -> bool:
    """Return true if any recording is current."""
    any_current = select(RECORDINGS.c.log_id).where(RECORDINGS.c.is_current).limit(1)
    return connection.execute(any_current).one_or_none() is not None


def stale_logs(connection: Connection) -> list[str]:
    """Return logs whose object changed under a reader since the last listing."""
    plans, shards = (select(table.c.log_id).where(_is_stale(table)) for table in (PLANS, SHARDS))
    return sorted(connection.execute(plans.union(shards)).scalars())


def register_pipeline(
    connection: Connection, pipeline_version: str, layers: Layers | None = None
) -> str:
    """Register a pipeline version; of several, the one registered last is the newest.

    Returns:
        The newest version before, if this one has just taken its place; else empty.
    """
    known = select(PIPELINES.c.ordinal).where(PIPELINES.c.pipeline_version == pipeline_version)
    if connection.execute(known).one_or_none() is not None:
        return ""
    newest = select(PIPELINES.c.pipeline_version, PIPELINES.c.ordinal)
    before = connection.execute(newest.order_by(PIPELINES.c.ordinal.desc()).limit(1)).one_or_none()
    ordinal = 1 if before is None else before.ordinal + 1
    digests = layers.model_dump() if layers else dict.fromkeys(Layers.model_fields, "")
    connection.execute(
        insert(PIPELINES).values(pipeline_version=pipeline_version, ordinal=ordinal, **digests)
    )
    return "" if before is None else str(before.pipeline_version)


def pipeline_versions(connection: Connection) -> list[str]:
    """Return every registered pipeline version, the oldest first."""
    query = select(PIPELINES.c.pipeline_version).order_by(PIPELINES.c.ordinal)
    return list(connection.execute(query).scalars())


def _retire(connection: Connection, going: Mapping[str, str]) -> None:
    """End the revisions of these logs, and cancel their open work.

    A revision without results and leases is deleted, since an upload makes one with every listing.
    """
    if not going:
        return
    made = select(PLANS.c.log_id, PLANS.c.revision).where(PLANS.c.state.not_in(OPEN)).distinct()
    kept = {tuple(row) for row in connection.execute(made)}
    held = [
        lease
        for lease in connection.execute(select(LEASES).where(LEASES.c.is_held))
        if going.get(lease.log_id) == lease.revision
    ]
    for lease in held:
        end_lease(connection, lease.lease_id, by="replaced")
        kept.add((lease.log_id, lease.revision))
    every = [{"at_log": log_id, "at_revision": going[log_id]} for log_id in going]
    for ending in (_END, *_CANCEL):
        connection.execute(ending, every)
    forgotten = [key for key in every if (key["at_log"], key["at_revision"]) not in kept]
    if forgotten:
        for forgetting in _FORGET:
            connection.execute(forgetting, forgotten)


def _enter_all(connection: Connection, entering: Sequence[Listed], *, now_s: float) -> None:
    """Make revisions the current ones of their logs; known ones are resumed."""
    if not entering:
        return
    past = select(RECORDINGS.c.log_id, RECORDINGS.c.revision).where(~RECORDINGS.c.is_current)
    known = {tuple(row) for row in connection.execute(past)}
    unknown = []
    for each in entering:
        if (each.recording.log_id, each.revision) in known:
            _enter_again(connection, log_id=each.recording.log_id, revision=each.revision)
            continue
        unknown.append(
            {
                "log_id": each.recording.log_id,
                "revision": each.revision,
                "recording": each.recording.model_dump_json(),
                "is_current": True,
                "listed_s": now_s,
                "content": content_digest(each.recording.parts),
                "same_as": "",
            }
        )
    if unknown:  # in one statement: ten thousand logs may appear at once
        connection.execute(insert(RECORDINGS), unknown)


def _enter_again(connection: Connection, *, log_id: str, revision: str) -> None:
    """Resume a revision that was current before."""
    for statement in (_BEGIN, *_GO_ON):
        connection.execute(statement, {"at_log": log_id, "at_revision": revision})
    enter_again(connection, log_id=log_id, revision=revision)


def _take_up_stale(connection: Connection) -> None:
    """Retry recordings that changed under a reader but are listed unchanged."""
    for table in (PLANS, SHARDS):
        connection.execute(update(table).where(_is_stale(table)).values(state=WorkState.READY))


def _is_stale(table: Table) -> ColumnElement[bool]:
    # Naming every pipeline version lets both servers use the index that begins with it.
    every = select(PIPELINES.c.pipeline_version)
    return and_(table.c.pipeline_version.in_(every), table.c.state == WorkState.STALE.value)


def _at(table: Table) -> ColumnElement[bool]:
    return and_(table.c.log_id == bindparam("at_log"), table.c.revision == bindparam("at_revision"))


# Built once: to build a statement costs more than to run it, and whole buckets come and go.
_BEGIN: Final = update(RECORDINGS).where(_at(RECORDINGS)).values(is_current=True)
_END: Final = update(RECORDINGS).where(_at(RECORDINGS)).values(is_current=False, same_as="")
_CANCEL: Final = tuple(
    update(table)
    .where(_at(table), or_(*(table.c.state == state.value for state in (*OPEN, WorkState.SAME))))
    .values(state=WorkState.CANCELLED, lease_id="")
    for table in (PLANS, SHARDS)
)
_GO_ON: Final = tuple(
    update(table)
    .where(_at(table), table.c.state == WorkState.CANCELLED)
    .values(state=WorkState.READY, ready_at_s=0.0)
    for table in (PLANS, SHARDS)
)
_FORGET: Final = tuple(delete(table).where(_at(table)) for table in (PLANS, RECORDINGS))
