"""Counts of waiting, running and parked work, from indexes alone; cheap enough for every scrape."""

from dataclasses import dataclass, field
from typing import Any, Final, Literal

from sqlalchemy import (
    ColumnElement,
    Connection,
    Table,
    and_,
    distinct,
    exists,
    func,
    or_,
    select,
    union,
)

from service.store.events import counter
from service.store.overview import newest_pipeline
from service.store.remining import RESTS_FROM, ReminingPolicy, budget_is_spent, spent_s
from service.store.tables import DAMAGE, DAMAGED, LEASES, PLANS, RECORDINGS, SCENES, SHARDS
from service.store.transaction_effects import WorkKind
from service.store.turns import NO_LIMIT
from service.store.verdict_rows import JudgedOutcome, judged_outcomes
from service.store.work_items import OPEN, WorkState

LogDamage = Literal["truncated", "unreadable"]
"""Damage of a log that is mined only in part. `truncated`: an object was never closed, and is used
up to its end. `unreadable`: stretches of complete objects cannot be read.
"""


@dataclass(frozen=True, slots=True)
class Backlog:
    """Counts of the ledger at one moment, under the newest pipeline version.

    Attributes:
        work: Plans and shards by kind and state; done ones of replaced recordings count as well.
        recordings: Current recordings by state, named as in `LogStatus`; also `resting`: to be
            mined again, when there is budget again.
        damaged: Current recordings that are mined only in part, by cause; each is counted once.
        damaged_stretches: Unreadable stretches of current recordings that any pipeline version
            found, so that a new one forgets none of them.
        noticed: Current recordings of which something was noticed that costs no byte of them.
        leases_held: Leases that workers hold.
        workers: Workers that hold them.
        current_scenes: Current scenes, of any pipeline version.
        unpublished: Events that the outbox has not published yet.
        judged_scenes: Records with a verdict that decides which stream is wrong, by the outcome.
        oldest_listed_s: First listing of the oldest recording with work left that does not rest,
            seconds of the service's clock; None when there is none.
        remined_s: Seconds of a core that mining again took within the last day.
    """

    work: dict[tuple[WorkKind, str], int] = field(default_factory=dict)
    recordings: dict[str, int] = field(default_factory=dict)
    damaged: dict[LogDamage, int] = field(default_factory=dict)
    damaged_stretches: int = 0
    noticed: int = 0
    leases_held: int = 0
    workers: int = 0
    current_scenes: int = 0
    unpublished: int = 0
    judged_scenes: dict[JudgedOutcome, int] = field(default_factory=dict)
    oldest_listed_s: float | None = None
    remined_s: float = 0.0


def backlog(connection: Connection, policy: ReminingPolicy, *, now_s: float) -> Backlog:
    """Count waiting, running and parked work, and what rests by the policy's budget of a day."""
    version = newest_pipeline(connection)
    remined_s = spent_s(connection, version, now_s=now_s)
    limit = RESTS_FROM if budget_is_spent(policy, remined_s) else NO_LIMIT
    plans, shards = (_by_state(connection, table, version) for table in (PLANS, SHARDS))
    held = connection.execute(_HELD).one()
    work: dict[tuple[WorkKind, str], int] = {("plan", state): n for state, n in plans.items()}
    work |= {("shard", state): n for state, n in shards.items()}
    return Backlog(
        work=work,
        recordings=_recordings(connection, version, limit=limit, now_s=now_s),
        damaged=_damaged(connection, version),
        damaged_stretches=connection.execute(_DAMAGED_STRETCHES).scalar_one(),
        noticed=_noticed(connection, version),
        leases_held=held.leases,
        workers=held.workers,
        current_scenes=connection.execute(_CURRENT_SCENES).scalar_one(),
        unpublished=counter(connection, "seq") - counter(connection, "published"),
        judged_scenes=judged_outcomes(connection),
        oldest_listed_s=_oldest_listed_s(connection, version, limit=limit),
        remined_s=remined_s,
    )


def _by_state(connection: Connection, table: Table, version: str) -> dict[str, int]:
    counted = connection.execute(
        select(table.c.state, func.count().label("works"))
        .where(table.c.pipeline_version == version)
        .group_by(table.c.state)
    )
    states = {row.state: row.works for row in counted}
    if WorkState.PARKED in states:  # work replaced while parked no longer counts
        states[WorkState.PARKED.value] = connection.execute(
            select(func.count())
            .select_from(table)
            .join(RECORDINGS, _same_log(table))
            .where(
                table.c.pipeline_version == version,
                table.c.state == WorkState.PARKED,
                RECORDINGS.c.is_current,
            )
        ).scalar_one()
    return states


def _recordings(
    connection: Connection, version: str, *, limit: int, now_s: float
) -> dict[str, int]:
    total: int = connection.execute(
        select(func.count())
        .select_from(RECORDINGS)
        .where(RECORDINGS.c.is_current, RECORDINGS.c.same_as == "")
    ).scalar_one()
    same: int = connection.execute(
        select(func.count())
        .select_from(RECORDINGS)
        .where(RECORDINGS.c.is_current, RECORDINGS.c.same_as != "")
    ).scalar_one()
    plans: dict[str, int] = {
        row.state: row.logs
        for row in connection.execute(
            select(PLANS.c.state, func.count().label("logs"))
            .join(RECORDINGS, _same_log(PLANS))
            .where(
                PLANS.c.pipeline_version == version,
                RECORDINGS.c.is_current,
                RECORDINGS.c.same_as == "",
            )
            .group_by(PLANS.c.state)
        )
    }
    settling: int = connection.execute(
        select(func.count())
        .select_from(PLANS)
        .where(
            PLANS.c.pipeline_version == version,
            PLANS.c.state == WorkState.READY,
            PLANS.c.error == "",  # the only rest that no failure ordered
            PLANS.c.ready_at_s > now_s,
        )
    ).scalar_one()
    unplanned: int = connection.execute(
        select(func.count())
        .select_from(PLANS)
        .join(RECORDINGS, _same_log(PLANS))
        .where(
            PLANS.c.pipeline_version == version,
            PLANS.c.state == WorkState.READY,
            PLANS.c.turn >= limit,
            or_(PLANS.c.error != "", PLANS.c.ready_at_s <= now_s),
            RECORDINGS.c.is_current,
        )
    ).scalar_one()
    stale = _logs_with_shards(connection, version, SHARDS.c.state == WorkState.STALE)
    mining = _logs_with_shards(connection, version, SHARDS.c.state.in_(OPEN)) - stale
    active = _logs_with_shards(connection, version, _is_active(SHARDS, limit)) & mining
    planned = plans.get(WorkState.DONE, 0)
    waiting = total - sum(plans.values()) + plans.get(WorkState.READY, 0) - settling
    return {
        "waiting": waiting - unplanned,
        "settling": settling,
        "planning": plans.get(WorkState.LEASED, 0),
        "mining": len(active),
        "resting": unplanned + len(mining) - len(active),
        "done": max(0, planned - len(mining) - len(stale)),
        "refused": plans.get(WorkState.REFUSED, 0),
        "parked": plans.get(WorkState.PARKED, 0),
        "stale": plans.get(WorkState.STALE, 0) + len(stale),
        "kept": plans.get(WorkState.KEPT, 0),
        "same": same,
    }


def _damaged(connection: Connection, version: str) -> dict[LogDamage, int]:
    is_cut = PLANS.c.truncated_parts > 0
    return {
        "truncated": _planned(connection, version, is_cut),
        "unreadable": _planned(connection, version, ~is_cut, _has_found(version, DAMAGED)),
    }


def _noticed(connection: Connection, version: str) -> int:
    return _planned(connection, version, _has_found(version, ~DAMAGED))


def _planned(connection: Connection, version: str, *which: ColumnElement[bool]) -> int:
    """Count the current recordings with a plan that are such."""
    planned: int = connection.execute(
        select(func.count())
        .select_from(PLANS)
        .join(RECORDINGS, _same_log(PLANS))
        .where(
            PLANS.c.pipeline_version == version,
            PLANS.c.state == WorkState.DONE,
            RECORDINGS.c.is_current,
            *which,
        )
    ).scalar_one()
    return planned


def _has_found(version: str, which: ColumnElement[bool]) -> ColumnElement[bool]:
    return exists().where(
        DAMAGE.c.pipeline_version == version,
        DAMAGE.c.log_id == PLANS.c.log_id,
        DAMAGE.c.revision == PLANS.c.revision,
        which,
    )


def _logs_with_shards(connection: Connection, version: str, which: ColumnElement[bool]) -> set[str]:
    logs = select(SHARDS.c.log_id).distinct().where(SHARDS.c.pipeline_version == version, which)
    return set(connection.execute(logs).scalars())


def _is_active(table: Table, limit: int) -> ColumnElement[bool]:
    """Return true for open work that does not rest."""
    return or_(
        table.c.state.in_((WorkState.LEASED, WorkState.STALE)),
        and_(table.c.state == WorkState.READY, table.c.turn < limit),
    )


def _oldest_listed_s(connection: Connection, version: str, *, limit: int) -> float | None:
    planned = select(PLANS.c.log_id).where(PLANS.c.pipeline_version == version)
    opened = union(
        planned.where(_is_active(PLANS, limit)),
        select(SHARDS.c.log_id).where(
            SHARDS.c.pipeline_version == version, _is_active(SHARDS, limit)
        ),
    )
    oldest: float | None = connection.execute(
        select(func.min(RECORDINGS.c.listed_s)).where(
            RECORDINGS.c.is_current,
            RECORDINGS.c.same_as == "",
            RECORDINGS.c.listed_s > 0,  # 0: listed before that was noted
            or_(RECORDINGS.c.log_id.in_(opened), RECORDINGS.c.log_id.not_in(planned)),
        )
    ).scalar_one()
    return oldest


def _same_log(table: Table) -> Any:
    return and_(table.c.log_id == RECORDINGS.c.log_id, table.c.revision == RECORDINGS.c.revision)


_HELD: Final = select(
    func.count().label("leases"), func.count(distinct(LEASES.c.worker_id)).label("workers")
).where(LEASES.c.is_held)
_CURRENT_SCENES: Final = select(func.count()).select_from(SCENES).where(SCENES.c.is_current)
_DAMAGED_STRETCHES: Final = select(func.count()).select_from(
    select(DAMAGE.c.log_id, DAMAGE.c.object_key, DAMAGE.c.byte_offset)
    .join(RECORDINGS, _same_log(DAMAGE))
    .where(RECORDINGS.c.is_current, DAMAGED)
    .distinct()
    .subquery()
)
"""Distinct stretches, since planning, shards and pipeline versions may find the same one."""
