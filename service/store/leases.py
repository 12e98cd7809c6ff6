"""Leases: who works on what until when, and what becomes of work whose lease ends badly."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import Connection, Row, and_, bindparam, delete, select, update

from schemas.work import Answer, FailRequest, RenewRequest
from service.store.revisions import take_over
from service.store.statements import Statement
from service.store.tables import LEASES, RECORDINGS
from service.store.transaction_effects import effects_of, kind_of
from service.store.work_items import Work, WorkState, change, row_of
from service.store.worker_deaths import History

LEASES_KEPT_S: Final = 7 * 86_400.0
"""Longer than any worker goes on with a result that it cannot get rid of."""

DEATHS_PER_ATTEMPT: Final = 2
"""So many times as many deaths as attempts end the work on which workers die, at the latest."""


@dataclass(frozen=True, slots=True)
class LeasePolicy:
    """How long a lease lasts, and how often work is tried before it is parked.

    Attributes:
        lease_s: A lease lives this long unrenewed.
        max_attempts: Leases of one plan or shard that may end badly; then it is parked. Deaths that
            are likelier the fault of the worker are not among them, but for the first.
        backoff_s: Pause after the first failure or death; doubles with each.
        max_backoff_s: Longest pause.
        plan_ahead: Logs are planned before shards are mined while fewer shards than this wait.
            Mining starts early, yet no worker idles while there is a log to open; and a plan is
            made shortly before it is used, so that few go stale in a bucket that changes.
        settle_s: A revision that was first listed so long ago is planned as it stands; before, only
            if it is complete.
    """

    lease_s: float = 30.0
    max_attempts: int = 5
    backoff_s: float = 2.0
    max_backoff_s: float = 60.0
    plan_ahead: int = 16
    settle_s: float = 0.0

    @property
    def max_deaths(self) -> int:
        """So many workers may die on one plan or shard, whoever is to blame; then it is parked."""
        return DEATHS_PER_ATTEMPT * self.max_attempts

    @property
    def heard_s(self) -> float:
        """A worker that finished something so long ago is still here: no rest takes longer."""
        return self.max_backoff_s + self.lease_s

    def is_settled(self, listed_s: float, *, now_s: float) -> bool:
        """Whether a revision has not changed for long enough; one listed in the future has not."""
        return now_s - min(listed_s, now_s) >= self.settle_s

    def pause_s(self, attempts: int) -> float:
        """How long work rests after this many failures."""
        return float(min(self.max_backoff_s, self.backoff_s * 2.0 ** min(attempts - 1, 30)))


def renew(
    connection: Connection, request: RenewRequest, *, now_s: float, policy: LeasePolicy
) -> Answer:
    """Lengthen a lease that is still held."""
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
    """Take a lease back with the error of its worker; a lease that is over is left alone."""
    lease = lease_of(connection, request.lease_id, worker_id=request.worker_id)
    if isinstance(lease, str):
        return Answer(ok=False, problem=lease)
    if lease.is_held and request.given_back:
        _free(connection, lease, by="given back")
    elif lease.is_held and request.growing and not lease.shard:
        _let_settle(connection, lease, now_s=now_s, policy=policy)
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
    """Take back the leases whose time is over."""
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
    """Take back the leases of one worker: an attempt, unless the worker is to blame (`blame`)."""
    its = select(LEASES).where(LEASES.c.is_held, LEASES.c.worker_id == worker_id)
    return _worker_died(
        connection, connection.execute(its), by="worker died", now_s=now_s, policy=policy
    )


def free_leases(connection: Connection, worker_prefix: str) -> int:
    """Take back the leases of a pool that was ended from outside: no attempt is counted."""
    theirs = connection.execute(
        select(LEASES).where(
            LEASES.c.is_held, LEASES.c.worker_id.startswith(worker_prefix, autoescape=True)
        )
    ).all()
    for lease in theirs:
        _free(connection, lease, by="freed")
    return len(theirs)


def prune(connection: Connection, *, now_s: float) -> None:
    """Forget leases that ended long ago; a commit under one is told to claim again."""
    connection.execute(
        delete(LEASES).where(~LEASES.c.is_held, LEASES.c.expires_s < now_s - LEASES_KEPT_S)
    )


def resume(connection: Connection, *, now_s: float, policy: LeasePolicy) -> None:
    """Give every held lease a full term: while no service ran, nobody could renew."""
    connection.execute(
        update(LEASES).where(LEASES.c.is_held).values(expires_s=now_s + policy.lease_s)
    )


def lease_of(connection: Connection, lease_id: str, *, worker_id: str) -> Row[Any] | str:
    """Find a lease, or say in one sentence why this worker cannot use it.

    Returns:
        A row of `LEASES`, with `is_current` and `listed_s` of its recording; or the sentence.
    """
    lease: Row[Any] | None = _LEASE.first(connection, {"at_lease": lease_id})
    if lease is None:
        return f"no such lease: {lease_id}; claim again"
    if lease.worker_id != worker_id:
        return f"lease {lease_id} belongs to worker {lease.worker_id}, not {worker_id}"
    return lease


def work_of(lease: Row[Any]) -> Work:
    """What a lease is for."""
    return Work(lease.log_id, lease.revision, lease.pipeline_version, lease.shard)


def end_lease(connection: Connection, lease_id: str, *, by: str) -> None:
    """Note that a lease is over, and why."""
    _END.rows(connection, {"at_lease": lease_id, "by": by})
    effects_of(connection).leases_ended[by] += 1


_AT: Final = LEASES.c.lease_id == bindparam("at_lease")
_RENEW: Final = Statement(update(LEASES).where(_AT).values(expires_s=bindparam("until_s")))
_END: Final = Statement(update(LEASES).where(_AT).values(is_held=False, ended_by=bindparam("by")))
_LEASE: Final = Statement(
    select(LEASES, RECORDINGS.c.is_current, RECORDINGS.c.listed_s)
    .join(
        RECORDINGS,
        and_(RECORDINGS.c.log_id == LEASES.c.log_id, RECORDINGS.c.revision == LEASES.c.revision),
    )
    .where(_AT)
    .with_for_update(of=LEASES)
)


def _free(connection: Connection, lease: Row[Any], *, by: str) -> None:
    """End a lease whose work is not to blame: it is ready at once, no attempt is counted."""
    end_lease(connection, lease.lease_id, by=by)
    work = work_of(lease)
    if row_of(connection, work).lease_id == lease.lease_id:
        change(connection, work, state=WorkState.READY, lease_id="")


def _let_settle(
    connection: Connection, lease: Row[Any], *, now_s: float, policy: LeasePolicy
) -> None:
    """Let the plan of a recording rest that still grows, until it has not changed for a while."""
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
    settled_s = min(lease.listed_s, now_s) + policy.settle_s
    change(connection, work, state=WorkState.READY, lease_id="", error="", ready_at_s=settled_s)


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
        work: What the lease was for.
        lease_id: The lease that ended; work that has gone on to another is left alone.
        error: What its worker said; empty when it died.
        policy: When to park, how long to rest.
        ready_at_s: From when on it may be claimed, before any rest.
        pauses: Whether it rests, longer with each attempt.
        parks: Whether it is parked at once.
        stale: Whether it waits for the next listing instead.
        deaths: How many workers have died on it, this one among them.
        counts: Whether the work is to blame; where it is not, only its first attempt is counted.
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
