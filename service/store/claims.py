"""Assignment of plans and shards to workers that claim work."""

from collections.abc import Iterable, Mapping
from typing import Any, Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Select,
    Table,
    and_,
    bindparam,
    func,
    insert,
    or_,
    select,
)

from schemas.work import ClaimRequest, MineLease, NothingToDo, PlanLease, Recording, Shard
from service.store.leases import LeasePolicy
from service.store.rescored_shards import rescored_shard
from service.store.statements import Statement
from service.store.tables import LEASES, PLANS, RECORDINGS, SHARDS
from service.store.turns import FIRST_TURN, NO_LIMIT, lane_of
from service.store.work_items import Work, WorkState, change
from service.store.worker_deaths import History

HEAD_START_S: Final = 3.0
"""Time for which work that ended badly is left to workers that have not died, seconds."""

WITHHELD_S: Final = 5.0
"""Time for which a worker gets none of the work left to another, seconds; deciding reads leases."""


def claim(
    connection: Connection,
    request: ClaimRequest,
    *,
    now_s: float,
    policy: LeasePolicy,
    lease_id: str,
    turns: Iterable[tuple[int, int]] = ((FIRST_TURN, NO_LIMIT),),
) -> PlanLease | MineLease | NothingToDo:
    """Lease the next work of this pipeline version.

    Shards are assigned by turn, then in the order of log, lidar and time, so that logs are finished
    one after the other. Only these stretches of turns are assigned, in their order. Work that ended
    badly before is left to a worker that is known to finish some (`worker_deaths`). While no such
    worker is known, a worker that has not died since it last finished something has a head start.
    """
    here = {
        "pipeline": request.pipeline_version,
        "now_s": now_s,
        # A rest longer than any was ordered before the clock stepped back: it is over.
        "beyond_s": now_s + policy.longest_rest_s,
        "enough": policy.plan_ahead,
    }
    withheld_s = 0.0
    for from_turn, below in turns:
        here |= {"from_turn": from_turn, "below_turn": below}
        grant = _claim(connection, request, here, now_s=now_s, policy=policy, lease_id=lease_id)
        if not isinstance(grant, float):
            return grant
        withheld_s = max(withheld_s, grant)
    if withheld_s:
        return NothingToDo(retry_after_s=withheld_s)
    # Soon, while a log is being planned, for its shards are about to come.
    planning = _PLANNING.first(connection, here)
    return NothingToDo(retry_after_s=1.0 if planning is None else 0.2)


def _claim(
    connection: Connection,
    request: ClaimRequest,
    here: Mapping[str, Any],
    *,
    now_s: float,
    policy: LeasePolicy,
    lease_id: str,
) -> PlanLease | MineLease | float:
    """Lease the next work of a stretch of turns, or return for how long some is withheld."""
    version = request.pipeline_version
    waiting = _WAITING.one(connection, here).waiting
    in_turn = (_PLAN, _SHARD) if waiting < policy.plan_ahead else (_SHARD, _PLAN)
    withheld_s = 0.0
    for query in in_turn:
        row = query.first(connection, here)
        if row is not None and row.error:
            history = History.read(
                connection, version, from_s=now_s - policy.heard_s, to_s=now_s + policy.lease_s
            )
            wait_s = _wait_s(history, request, row, is_shard=query is _SHARD, now_s=now_s)
            if wait_s:
                row, withheld_s = _UNTRIED[query].first(connection, here), wait_s
        if row is not None:
            work = Work(row.log_id, row.revision, version, row.name if query is _SHARD else "")
            _lease(
                connection,
                work,
                request,
                lease_id=lease_id,
                until_s=now_s + policy.lease_s,
                lane=lane_of(row.turn),
            )
            recording = Recording.model_validate_json(row.recording)
            if query is _PLAN:
                return PlanLease(
                    lease_id=lease_id,
                    expires_s=policy.lease_s,
                    recording=recording,
                    settled=policy.is_settled(row.listed_s, now_s=now_s),
                    waits=policy.settle_s > 0,
                )
            return MineLease(
                lease_id=lease_id,
                expires_s=policy.lease_s,
                recording=recording,
                shard=Shard.model_validate_json(row.shard),
                rescore=(rescored_shard(connection, work, row) if row.rescored_from else None),
            )
    return withheld_s


def _wait_s(
    history: History, request: ClaimRequest, row: Row[Any], *, is_shard: bool, now_s: float
) -> float:
    """Return for how long work that ended badly is left to other workers, seconds."""
    if history.is_to_wait(request.worker_id, is_shard=is_shard):
        return WITHHELD_S
    left_s = float(row.ready_at_s) + HEAD_START_S - now_s
    has_rested = now_s >= row.ready_at_s  # not so after the clock stepped back
    return max(0.0, left_s) if has_rested and history.died_last(request.worker_id) else 0.0


def _lease(
    connection: Connection,
    work: Work,
    request: ClaimRequest,
    *,
    lease_id: str,
    until_s: float,
    lane: int,
) -> None:
    change(connection, work, state=WorkState.LEASED, lease_id=lease_id)
    _INSERT_LEASE.rows(
        connection,
        {
            "lease_id": lease_id,
            "worker_id": request.worker_id,
            "log_id": work.log_id,
            "revision": work.revision,
            "pipeline_version": work.pipeline_version,
            "shard": work.shard,
            "expires_s": until_s,
            "is_held": True,
            "ended_by": "",
            "lane": lane,
        },
    )


def _ready(table: Table) -> ColumnElement[bool]:
    rested = or_(
        table.c.ready_at_s <= bindparam("now_s"), table.c.ready_at_s > bindparam("beyond_s")
    )
    return and_(
        table.c.pipeline_version == bindparam("pipeline"),
        table.c.state == WorkState.READY.value,
        table.c.turn >= bindparam("from_turn"),
        table.c.turn < bindparam("below_turn"),
        rested,
    )


def _next(table: Table, *columns: Any) -> Select[Any]:
    return (
        select(
            table.c.log_id,
            table.c.revision,
            table.c.error,
            table.c.ready_at_s,
            table.c.turn,
            RECORDINGS.c.recording,
            *columns,
        )
        .join(
            RECORDINGS,
            and_(RECORDINGS.c.log_id == table.c.log_id, RECORDINGS.c.revision == table.c.revision),
        )
        .where(_ready(table))
        .limit(1)
        .with_for_update(skip_locked=True, of=table)
    )


_TAKEN: Final = ("rescored_from", "taken_from_log", "taken_from_revision")
_NEXT_PLAN: Final = _next(PLANS, RECORDINGS.c.listed_s).order_by(PLANS.c.turn, PLANS.c.log_id)
_NEXT_SHARD: Final = _next(
    SHARDS, SHARDS.c.name, SHARDS.c.shard, *(SHARDS.c[name] for name in _TAKEN)
).order_by(SHARDS.c.turn, SHARDS.c.log_id, SHARDS.c.lidar_topic, SHARDS.c.shard_index)

# Built once: to build a statement costs more than to run it.
_PLAN: Final = Statement(_NEXT_PLAN)
_SHARD: Final = Statement(_NEXT_SHARD)
_UNTRIED: Final = {
    _PLAN: Statement(_NEXT_PLAN.where(PLANS.c.error == "")),
    _SHARD: Statement(_NEXT_SHARD.where(SHARDS.c.error == "")),
}
_INSERT_LEASE: Final = Statement(insert(LEASES))
# Shards that come after the next plan do not count, or a log of a later turn would delay it.
_NEXT_TURN: Final = (
    select(PLANS.c.turn).where(_ready(PLANS)).order_by(PLANS.c.turn).limit(1).scalar_subquery()
)
_WAITING: Final = Statement(
    select(func.count().label("waiting")).select_from(
        select(SHARDS.c.name)
        .where(_ready(SHARDS), SHARDS.c.turn <= func.coalesce(_NEXT_TURN, NO_LIMIT))
        .limit(bindparam("enough"))
        .subquery()
    )
)
_PLANNING: Final = Statement(
    select(PLANS.c.log_id)
    .where(PLANS.c.pipeline_version == bindparam("pipeline"), PLANS.c.state == WorkState.LEASED)
    .limit(1)
)
