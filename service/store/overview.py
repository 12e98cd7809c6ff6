"""Status counts over the ledger: progress of each log, damaged stretches, parked work."""

import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from typing import Any, Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Table,
    and_,
    exists,
    func,
    literal,
    or_,
    select,
)

from schemas.work import Damage
from service.curation.status import LogStatus, ParkedWork, PointTotals, Status
from service.store.compared_streams import judged
from service.store.skipped_entries import skipped_entries
from service.store.tables import COUNTERS, DAMAGE, PIPELINES, PLANS, RECORDINGS, SCENES, SHARDS
from service.store.work_items import OPEN, WorkState

RATE_WINDOW_S: Final = 60.0
"""Window of rates over commits, seconds; long against a shard, short against a night."""


def settled(connection: Connection, pipeline_version: str) -> bool:
    """Return true if no work is left for any current recording under this pipeline version."""
    is_planned = exists().where(
        _same_log(PLANS), PLANS.c.pipeline_version == pipeline_version, PLANS.c.state.not_in(OPEN)
    )
    is_open = exists().where(
        _same_log(SHARDS), SHARDS.c.pipeline_version == pipeline_version, SHARDS.c.state.in_(OPEN)
    )
    unsettled = select(RECORDINGS.c.log_id).where(
        RECORDINGS.c.is_current, RECORDINGS.c.same_as == "", or_(~is_planned, is_open)
    )
    return connection.execute(unsettled.limit(1)).one_or_none() is None


def status(connection: Connection, pipeline_version: str | None, *, now_s: float) -> Status:
    """Return the status under one pipeline version; by default the newest."""
    if pipeline_version is None:
        pipeline_version = newest_pipeline(connection)
    plans = {
        row.log_id: row for row in connection.execute(_current_rows(PLANS, pipeline_version, PLANS))
    }
    shards: defaultdict[str, list[Row[Any]]] = defaultdict(list)
    for row in connection.execute(_shard_sums(pipeline_version)):
        shards[row.log_id].append(row)
    damage = _damage(connection, pipeline_version)
    listed = connection.execute(
        select(RECORDINGS.c.log_id, RECORDINGS.c.same_as)
        .where(RECORDINGS.c.is_current)
        .order_by(RECORDINGS.c.log_id)
    )
    logs = tuple(
        LogStatus(log_id=log_id, state="same", problem=f"same bytes as {same_as}")
        if same_as
        else _log_status(
            *(log_id, plans.get(log_id), shards[log_id], damage.get(log_id, [])), now_s=now_s
        )
        for log_id, same_as in listed
    )
    counters = {row.name: row.value for row in connection.execute(select(COUNTERS))}
    return Status(
        pipeline_version=pipeline_version,
        logs=logs,
        logs_by_state=dict(sorted(Counter(log.state for log in logs).items())),
        shards_by_state=_total(log.shards for log in logs),
        parked=_stuck(connection, pipeline_version, _is_parked),
        retried=_stuck(connection, pipeline_version, _is_retried),
        scenes=connection.execute(
            select(func.count()).select_from(SCENES).where(SCENES.c.is_current)
        ).scalar_one(),
        frames=sum(log.frames for log in logs),
        frames_per_s=_frames_per_s(connection, pipeline_version, now_s=now_s),
        bytes_read=sum(log.mine_bytes_read for log in logs),
        bytes_needed=sum(log.bytes_needed for log in logs),
        plan_bytes_read=sum(log.plan_bytes_read for log in logs),
        peak_memory_bytes=max((log.peak_memory_bytes for log in logs), default=0),
        points=_points(connection),
        skipped=skipped_entries(connection),
        judged=judged(connection),
        last_seq=counters["seq"],
        published_seq=counters["published"],
    )


def _same_log(table: Table) -> ColumnElement[bool]:
    return and_(table.c.log_id == RECORDINGS.c.log_id, table.c.revision == RECORDINGS.c.revision)


def _current_rows(table: Table, pipeline_version: str, *columns: Any) -> Any:
    return (
        select(*columns)
        .join(RECORDINGS, _same_log(table))
        .where(RECORDINGS.c.is_current, table.c.pipeline_version == pipeline_version)
        .order_by(*table.primary_key.columns)
    )


def _shard_sums(pipeline_version: str) -> Any:
    """Select sums over the shards of each log and state; a log of a day has hundreds of shards."""
    sums = (func.sum(SHARDS.c[name]).label(name) for name in _SUMMED)
    return (
        select(
            SHARDS.c.log_id,
            SHARDS.c.state,
            func.count().label("shards"),
            func.max(SHARDS.c.peak_memory_bytes).label("peak_memory_bytes"),
            *sums,
        )
        .join(RECORDINGS, _same_log(SHARDS))
        .where(RECORDINGS.c.is_current, SHARDS.c.pipeline_version == pipeline_version)
        .group_by(SHARDS.c.log_id, SHARDS.c.state)
        .order_by(SHARDS.c.log_id, SHARDS.c.state)
    )


_SUMMED: Final = ("frames", "bytes_read", "bytes_needed", "range_reads")


def newest_pipeline(connection: Connection) -> str:
    """Return the newest pipeline version; empty before any worker has claimed work."""
    newest = select(PIPELINES.c.pipeline_version).order_by(PIPELINES.c.ordinal.desc()).limit(1)
    return connection.execute(newest).scalar_one_or_none() or ""


def _damage(connection: Connection, pipeline_version: str) -> dict[str, list[Damage]]:
    """Return each damaged stretch once; planning and several shards may have found the same one."""
    found: defaultdict[str, set[tuple[str, int, int, str]]] = defaultdict(set)
    for row in connection.execute(_current_rows(DAMAGE, pipeline_version, DAMAGE)):
        found[row.log_id].add((row.object_key, row.byte_offset, row.byte_count, row.what))
    return {
        log_id: [
            Damage(key=key, offset=offset, bytes=count, what=what)
            for key, offset, count, what in sorted(stretches)
        ]
        for log_id, stretches in found.items()
    }


def _log_status(
    log_id: str,
    plan: Row[Any] | None,
    shards: list[Row[Any]],
    damage: list[Damage],
    *,
    now_s: float,
) -> LogStatus:
    by_state = {row.state: row.shards for row in shards}
    if plan is None:
        return LogStatus(log_id=log_id, state="waiting")
    return LogStatus(
        log_id=log_id,
        state="settling" if _rests(plan, now_s=now_s) else _log_state(plan.state, by_state),
        vehicle=plan.vehicle,
        date=plan.date,
        software_version=plan.software_version,
        lidar_topics=tuple(json.loads(plan.lidar_topics)),
        problem=plan.error,
        truncated_parts=plan.truncated_parts,
        damage=tuple(damage),
        shards=by_state,
        frames=_sum(row.frames for row in shards),
        plan_range_reads=plan.range_reads,
        plan_bytes_read=plan.bytes_read,
        mine_range_reads=_sum(row.range_reads for row in shards),
        mine_bytes_read=_sum(row.bytes_read for row in shards),
        bytes_needed=_sum(row.bytes_needed for row in shards),
        peak_memory_bytes=max((row.peak_memory_bytes for row in shards), default=0),
    )


def _rests(plan: Row[Any], *, now_s: float) -> bool:
    """Return true if a plan waits for its recording to settle, the only pause without a failure."""
    return plan.state == WorkState.READY and not plan.error and bool(plan.ready_at_s > now_s)


def _log_state(plan: str, shards: dict[str, int]) -> str:
    if plan == WorkState.DONE:
        if shards.get(WorkState.STALE):
            return "stale"
        return "mining" if any(shards.get(state) for state in OPEN) else "done"
    return {WorkState.READY: "waiting", WorkState.LEASED: "planning"}.get(WorkState(plan), plan)


def _total(counts: Any) -> dict[str, int]:
    total: Counter[str] = Counter()
    for count in counts:
        total.update(count)
    return dict(sorted(total.items()))


def _sum(values: Iterable[Any]) -> int:
    return sum(int(value) for value in values)  # PostgreSQL sums to a decimal


def _stuck(
    connection: Connection, pipeline_version: str, which: Callable[[Table], ColumnElement[bool]]
) -> tuple[ParkedWork, ...]:
    stuck: list[ParkedWork] = []
    for table, name in ((PLANS, literal("")), (SHARDS, SHARDS.c.name)):
        columns = (table.c.log_id, name.label("shard"), table.c.attempts, table.c.error)
        rows = _current_rows(table, pipeline_version, *columns).where(which(table))
        stuck += (ParkedWork(**row) for row in connection.execute(rows).mappings())
    return tuple(sorted(stuck, key=lambda work: (work.log_id, work.shard)))


def _is_parked(table: Table) -> ColumnElement[bool]:
    return table.c.state == WorkState.PARKED


def _is_retried(table: Table) -> ColumnElement[bool]:
    """Select work that was parked and opened again, which has an error without an attempt."""
    return and_(table.c.state.in_(OPEN), table.c.attempts == 0, table.c.error != "")


def _frames_per_s(connection: Connection, pipeline_version: str, *, now_s: float) -> float:
    """Return the rate of frames since the oldest commit of the window, frames per second.

    The frames of that commit do not count, since the start of their mining is unknown.
    """
    recent = and_(
        SHARDS.c.pipeline_version == pipeline_version,
        SHARDS.c.adopted_from == "",
        SHARDS.c.rescored_from == "",
        SHARDS.c.committed_s > now_s - RATE_WINDOW_S,
        SHARDS.c.committed_s <= now_s,
    )
    oldest_s: float | None = connection.execute(
        select(func.min(SHARDS.c.committed_s)).where(recent)
    ).scalar_one()
    if oldest_s is None or now_s <= oldest_s:
        return 0.0
    frames = connection.execute(
        select(func.coalesce(func.sum(SHARDS.c.frames), 0)).where(
            recent, SHARDS.c.committed_s > oldest_s
        )
    ).scalar_one()
    return int(frames) / (now_s - oldest_s)  # PostgreSQL sums to a decimal


def _points(connection: Connection) -> PointTotals:
    names = tuple(PointTotals.model_fields)
    row = connection.execute(
        select(*(func.coalesce(func.sum(SCENES.c[name]), 0).label(name) for name in names)).where(
            SCENES.c.is_current
        )
    ).one()
    return PointTotals(**{name: int(row._mapping[name]) for name in names})
