"""Leases: a worker's time-limited right to a plan or shard, and retries after failures."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, Row, and_, bindparam, delete, select, update

from schemas.arrays import NS_PER_S
from schemas.work import Answer, FailRequest, RenewRequest
from service.store.remining import turn_of_log
from service.store.revisions import take_over
from service.store.statements import Statement
from service.store.tables import LEASES, RECORDINGS
from service.store.transaction_effects import effects_of, kind_of
from service.store.turns import Kind, lane_of, turn_of
from service.store.work_items import Work, WorkState, change, row_of
from service.store.worker_deaths import History

LEASES_KEPT_S: Final = 7 * 86_400.0
"""Time for which ended leases are kept, seconds; longer than any worker retries a commit."""

DEATHS_PER_ATTEMPT: Final = 2
"""Deaths per attempt: this many times `max_attempts` deaths park the work at the latest."""


AWAITED_SHARE: Final = 1 / 8
"""Pause between two looks for the predictions of a log, as a share of its age."""

MOST_AWAITED_S: Final = 300.0
"""Longest pause between two looks for the predictions of a log, seconds."""


@dataclass(frozen=True, slots=True)
class LeasePolicy:
    """Duration of leases, and number of attempts before work is parked.

    Attributes:
        lease_s: Duration of a lease without renewal, seconds.
        max_attempts: Leases of one plan or shard that may end badly before it is parked. Deaths
            that are more likely the fault of the worker do not count, except the first.
        backoff_s: Pause after the first failure or death, seconds; doubles with each.
        max_backoff_s: Longest pause, seconds.
        plan_ahead: Logs are planned before shards are mined while fewer shards than this wait.
            Mining starts early, yet no worker idles while there is a log to open. A plan is also
            made shortly before its use, so few become stale in a bucket that changes.
        settle_s: Age of a first listing after which a revision is planned in any state, seconds;
            before, only if it is complete.
    """

    lease_s: float = 30.0
    max_attempts: int = 5
    backoff_s: float = 2.0
    max_backoff_s: float = 60.0
    plan_ahead: int = 16
    settle_s: float = 0.0

    @property
    def max_deaths(self) -> int:
        """Worker deaths on one plan or shard, of any cause, after which it is parked."""
        return DEATHS_PER_ATTEMPT * self.max_attempts

    @property
    def heard_s(self) -> float:
        """Time after its last finished work for which a worker counts as present, seconds.

        No pause is longer.
        """
        return self.max_backoff_s + self.lease_s

    def is_settled(self, listed_s: float, *, now_s: float) -> bool:
        """Return true if a revision has settled; one listed in the future has not."""
        return now_s - min(listed_s, now_s) >= self.settle_s

    @property
    def longest_rest_s(self) -> float:
        """Longest pause that is ever ordered, seconds."""
        return max(self.max_backoff_s, self.settle_s, MOST_AWAITED_S)

    def look_again_s(self, listed_s: float, *, now_s: float) -> float:
        """Return when to look again for the predictions of a revision: after a part of its age."""
        age_s = max(0.0, now_s - listed_s)
        return now_s + min(max(self.settle_s, AWAITED_SHARE * age_s), MOST_AWAITED_S)

    def pause_s(self, attempts: int) -> float:
        """Return the pause of work after this many failures, seconds."""
        return float(min(self.max_backoff_s, self.backoff_s * 2.0 ** min(attempts - 1, 30)))


def renew(
    connection: Connection, request: RenewRequest, *, now_s: float, policy: LeasePolicy
) -> Answer:
    """Extend a lease that is still held."""
    lease = lease_of(connection, request.lease_id, worker_id=request.worker_id)
    if isinstance(lease, str):
        return Answer(ok=False, problem=lease)
    if not lease.is_held:
        return Answer(ok=False, problem=f"lease is over: {lease.ended_by}")
    _RENEW.rows(connection, {"at_lease": request.lease_id, "until_s": now_s + policy.lease_s})
    return Answer(ok=True)


def fail(
    connection: Connection, request: FailRequest, *, now_s: float, policy: LeasePolicy
) -> Answer:
    """End a lease with the error of its worker; a lease that is over is left alone."""
    lease = lease_of(connection, request.lease_id, worker_id=request.worker_id)
    if isinstance(lease, str):
        return Answer(ok=False, problem=lease)
    if lease.is_held and request.given_back:
        _free(connection, lease, by="given back")
    elif lease.is_held and request.not_rescored and lease.shard:
        _mine_instead(connection, lease)
    elif lease.is_held and request.growing and not lease.shard:
        settled_s = min(lease.listed_s, now_s) + policy.settle_s
        _let_rest(connection, lease, now_s=now_s, until_s=settled_s)
    elif lease.is_held and request.awaits and not lease.shard:
        until_s = policy.look_again_s(lease.listed_s, now_s=now_s)
        _let_rest(connection, lease, now_s=now_s, until_s=until_s)
    elif lease.is_held:
        end_lease(connection, lease.lease_id, by="failed")
        _give_back(
            connection,
            work_of(lease),
            lease_id=lease.lease_id,
            error=request.error,
            policy=policy,
            ready_at_s=now_s,
            pauses=True,
            parks=request.permanent and not request.replaced,
            stale=request.replaced,
        )
    return Answer(ok=True)


def expire(connection: Connection, *, now_s: float, policy: LeasePolicy) -> int:
    """End the leases whose time is over."""
    # An end further ahead than any lease reaches was set before the clock stepped back.
    connection.execute(
        update(LEASES)
        .where(LEASES.c.is_held, LEASES.c.expires_s > now_s + policy.lease_s)
        .values(expires_s=now_s + policy.lease_s)
    )
    over = connection.execute(
        select(LEASES).where(LEASES.c.is_held, LEASES.c.expires_s <= now_s)
    ).all()
    return _worker_died(connection, over, by="expired", now_s=now_s, policy=policy)


def worker_died(
    connection: Connection, worker_id: str, *, now_s: float, policy: LeasePolicy
) -> int:
    """End the leases of one dead worker; an attempt each, unless the worker is to blame."""
    its = select(LEASES).where(LEASES.c.is_held, LEASES.c.worker_id == worker_id)
    return _worker_died(
        connection, connection.execute(its), by="worker died", now_s=now_s, policy=policy
    )


def free_leases(connection: Connection, worker_prefix: str) -> int:
    """End the leases of a pool that was stopped from outside; no attempt is counted."""
    theirs = connection.execute(
        select(LEASES).where(
            LEASES.c.is_held, LEASES.c.worker_id.startswith(worker_prefix, autoescape=True)
        )
    ).all()
    for lease in theirs:
        _free(connection, lease, by="freed")
    return len(theirs)


def prune(connection: Connection, *, now_s: float) -> None:
    """Delete leases that ended long ago; a commit under one is refused, and must claim again."""
    connection.execute(
        delete(LEASES).where(~LEASES.c.is_held, LEASES.c.expires_s < now_s - LEASES_KEPT_S)
    )


def resume(connection: Connection, *, now_s: float, policy: LeasePolicy) -> None:
    """Extend every held lease to a full term, since none could be renewed while no service ran."""
    connection.execute(
        update(LEASES).where(LEASES.c.is_held).values(expires_s=now_s + policy.lease_s)
    )


def lease_of(connection: Connection, lease_id: str, *, worker_id: str) -> Row[Any] | str:
    """Find a lease, or return the sentence for which this worker cannot use it.

    Returns:
        A row of `LEASES`, with `is_current`, `listed_s` and `content` of its recording; or the
        sentence.
    """
    lease: Row[Any] | None = _LEASE.first(connection, {"at_lease": lease_id})
    if lease is None:
        return f"no such lease: {lease_id}; claim again"
    if lease.worker_id != worker_id:
        return f"lease {lease_id} belongs to worker {lease.worker_id}, not {worker_id}"
    return lease


def work_of(lease: Row[Any]) -> Work:
    """Return the plan or shard of a lease."""
    return Work(lease.log_id, lease.revision, lease.pipeline_version, lease.shard)


def end_lease(connection: Connection, lease_id: str, *, by: str) -> None:
    """Record the end of a lease, and its cause."""
    _END.rows(connection, {"at_lease": lease_id, "by": by})
    effects_of(connection).leases_ended[by] += 1


_AT: Final = LEASES.c.lease_id == bindparam("at_lease")
_RENEW: Final = Statement(update(LEASES).where(_AT).values(expires_s=bindparam("until_s")))
_END: Final = Statement(update(LEASES).where(_AT).values(is_held=False, ended_by=bindparam("by")))
_LEASE: Final = Statement(
    select(LEASES, RECORDINGS.c.is_current, RECORDINGS.c.listed_s, RECORDINGS.c.content)
    .join(
        RECORDINGS,
        and_(RECORDINGS.c.log_id == LEASES.c.log_id, RECORDINGS.c.revision == LEASES.c.revision),
    )
    .where(_AT)
    .with_for_update(of=LEASES)
)


def _free(connection: Connection, lease: Row[Any], *, by: str) -> None:
    """End a lease whose work is not to blame: it is ready at once, and no attempt is counted."""
    end_lease(connection, lease.lease_id, by=by)
    work = work_of(lease)
    if row_of(connection, work).lease_id == lease.lease_id:
        change(connection, work, state=WorkState.READY, lease_id="")


def _mine_instead(connection: Connection, lease: Row[Any]) -> None:
    """Have a shard mined whose scores could not be computed again, in the turn of its log."""
    end_lease(connection, lease.lease_id, by="not rescored")
    work = work_of(lease)
    row = row_of(connection, work)
    if row.lease_id == lease.lease_id:
        if row.taken_from_log:  # its own log was never mined
            turn = turn_of(Kind.NEW, lane=lane_of(row.turn))
        else:
            newest_s = json.loads(row.shard)["start_ns"] / NS_PER_S
            turn = turn_of_log(connection, work.log_id, newest_s=newest_s, turn=row.turn)
        change(
            connection,
            work,
            state=WorkState.READY,
            lease_id="",
            rescored_from="",
            taken_from_log="",
            taken_from_revision="",
            turn=turn,
        )


def _let_rest(connection: Connection, lease: Row[Any], *, now_s: float, until_s: float) -> None:
    """Postpone the plan of a recording that is not complete; no attempt is used up."""
    end_lease(connection, lease.lease_id, by="growing")
    work = work_of(lease)
    if row_of(connection, work).lease_id != lease.lease_id:
        return
    if lease.listed_s > now_s:  # listed before the clock stepped back: it settles from now on
        connection.execute(
            update(RECORDINGS)
            .where(RECORDINGS.c.log_id == work.log_id, RECORDINGS.c.revision == work.revision)
            .values(listed_s=now_s)
        )
    change(connection, work, state=WorkState.READY, lease_id="", error="", ready_at_s=until_s)


def _worker_died(
    connection: Connection,
    leases: Iterable[Row[Any]],
    *,
    by: str,
    now_s: float,
    policy: LeasePolicy,
) -> int:
    ended = list(leases)
    for lease in ended:
        end_lease(connection, lease.lease_id, by=by)
    histories = {
        version: History.read(connection, version, from_s=now_s, to_s=now_s)
        for version in {lease.pipeline_version for lease in ended}
    }
    for lease in ended:
        history, work = histories[lease.pipeline_version], work_of(lease)
        _give_back(
            connection,
            work,
            lease_id=lease.lease_id,
            error="",
            policy=policy,
            ready_at_s=now_s,
            pauses=True,
            deaths=history.deaths_on(work),
            counts=not history.blames_worker(lease.worker_id, work),
        )
    return len(ended)


def _give_back(
    connection: Connection,
    work: Work,
    *,
    lease_id: str,
    error: str,
    policy: LeasePolicy,
    ready_at_s: float,
    pauses: bool = False,
    parks: bool = False,
    stale: bool = False,
    deaths: int = 0,
    counts: bool = True,
) -> None:
    """Count an attempt, and park the work or make it ready again.

    Args:
        connection: In a transaction that writes.
        work: Plan or shard of the lease.
        lease_id: The lease that ended; work that has gone on to another is left alone.
        error: Error of its worker; empty when it died.
        policy: Number of attempts and pauses.
        ready_at_s: Earliest time of the next claim, before any pause, seconds.
        pauses: True to pause, longer with each attempt.
        parks: True to park at once.
        stale: True to wait for the next listing instead.
        deaths: Workers that have died on it, including this one.
        counts: True if the work is to blame; otherwise only its first attempt is counted.
    """
    row = row_of(connection, work)
    if row.lease_id != lease_id:
        return
    attempts = row.attempts + 1 if counts else max(1, row.attempts)
    if not error:
        error = _died(deaths, verb="mining" if work.shard else "planning", before=row.error)
    worn_out = counts and attempts >= policy.max_attempts
    if parks or worn_out or deaths >= policy.max_deaths:
        state = WorkState.PARKED
        effects_of(connection).parked[kind_of(work.shard)] += 1
    else:
        state = WorkState.STALE if stale else WorkState.READY
    rest_s = policy.pause_s(max(attempts, deaths)) if pauses else 0.0
    change(
        connection,
        work,
        state=state,
        lease_id="",
        attempts=attempts,
        error=error,
        ready_at_s=ready_at_s + rest_s,
    )
    if state == WorkState.PARKED and not work.shard:
        take_over(connection, log_id=work.log_id, revision=work.revision)


def _died(deaths: int, *, verb: str, before: str) -> str:
    if before and not before.startswith("worker died"):
        return f"worker died while {verb} it; before that: {before}"
    times = "once" if deaths == 1 else f"{deaths} times"
    return f"worker died {times} while {verb} it"
