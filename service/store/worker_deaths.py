"""Attribution of worker deaths to the work or to the worker, from past leases.

A death counts against its work, unless the worker, or its whole machine, has died on other work
since it last finished something. Work that ended badly before waits for a worker that has finished
something since it last died, as long as there is one. Work on which `LeasePolicy.max_deaths`
workers died is parked, for any cause.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from sqlalchemy import Connection, func, or_, select, update

from service.store.tables import LEASES
from service.store.work_items import Work

DEATHS: Final = ("worker died", "expired")
"""Ends of leases whose worker is no longer heard of."""

PARDONED: Final = "pardoned"
"""End of a death's lease after its work was retried on request."""


def machine_of(worker_id: str) -> str:
    """Return the machine of a worker: its id without the last two parts, pool and place."""
    parts = worker_id.rsplit("-", 2)
    return parts[0] if len(parts) == 3 else worker_id


@dataclass(frozen=True, slots=True)
class Death:
    """A lease that ended with its worker.

    Attributes:
        worker_id: Id of the dead worker.
        work: Its plan or shard.
        at_s: End of its lease, seconds.
    """

    worker_id: str
    work: Work
    at_s: float


class History:
    """Ends of the leases of one pipeline version, as far back as leases are kept."""

    def __init__(
        self, finished: dict[tuple[str, bool], float], deaths: Iterable[Death], heard: set[str]
    ) -> None:
        """Keep the result of a query.

        Args:
            finished: Time of a worker's last finished work, by its id and a flag for shards,
                seconds.
            deaths: All deaths.
            heard: Ids of the workers that were heard of recently.
        """
        self._finished, self._deaths, self._heard = finished, list(deaths), heard
        self._machine: defaultdict[str, set[str]] = defaultdict(set)
        for worker_id in {who for who, _ in finished} | {death.worker_id for death in self._deaths}:
            self._machine[machine_of(worker_id)].add(worker_id)

    @classmethod
    def read(cls, connection: Connection, version: str, *, from_s: float, to_s: float) -> "History":
        """Read the leases of a pipeline version.

        Args:
            connection: In a transaction.
            version: Pipeline version.
            from_s: A worker counts as heard of if its lease ends later than this, seconds.
            to_s: No lease ends later than this, unless the clock has stepped back.
        """
        is_shard = (LEASES.c.shard != "").label("is_shard")
        last_s = func.max(LEASES.c.expires_s).label("last_s")
        here = LEASES.c.pipeline_version == version
        finished = connection.execute(
            select(LEASES.c.worker_id, is_shard, last_s)
            .where(here, LEASES.c.ended_by == "committed")
            .group_by(LEASES.c.worker_id, is_shard)
        )
        deaths = connection.execute(select(LEASES).where(here, LEASES.c.ended_by.in_(DEATHS)))
        heard = connection.execute(
            select(LEASES.c.worker_id)
            .distinct()
            .where(
                here,
                or_(LEASES.c.is_held, LEASES.c.expires_s > from_s),
                LEASES.c.expires_s <= to_s,
            )
        )
        return cls(
            {(row.worker_id, bool(row.is_shard)): row.last_s for row in finished},
            (
                Death(
                    row.worker_id,
                    Work(row.log_id, row.revision, row.pipeline_version, row.shard),
                    row.expires_s,
                )
                for row in deaths
            ),
            set(heard.scalars()),
        )

    def deaths_on(self, work: Work) -> int:
        """Count the workers that died on this work."""
        return sum(death.work == work for death in self._deaths)

    def blames_worker(self, worker_id: str, work: Work) -> bool:
        """Return true if a death on this work is more likely the fault of its worker or machine."""
        mates = self._machine[machine_of(worker_id)]
        return any(self._died_elsewhere(who, work) for who in ({worker_id}, mates))

    def is_to_wait(self, worker_id: str, *, is_shard: bool) -> bool:
        """Return true if work that ended badly is better left to another active worker."""
        return not self._is_proven(worker_id, is_shard=is_shard) and any(
            self._is_proven(other, is_shard=is_shard) for other in self._heard - {worker_id}
        )

    def died_last(self, worker_id: str) -> bool:
        """Return true if this worker has died since it last finished a plan or a shard."""
        died_s = self._last_died_s({worker_id}, lambda _: True)
        return died_s > self._last_finished_s({worker_id}, is_shard=False)

    def _is_proven(self, worker_id: str, *, is_shard: bool) -> bool:
        finished_s = self._last_finished_s({worker_id}, is_shard=is_shard)
        died_s = self._last_died_s({worker_id}, lambda work: bool(work.shard) >= is_shard)
        return finished_s > -math.inf and finished_s >= died_s

    def _died_elsewhere(self, workers: set[str], work: Work) -> bool:
        is_shard = bool(work.shard)
        died_s = self._last_died_s(
            workers, lambda other: other != work and bool(other.shard) >= is_shard
        )
        return died_s > self._last_finished_s(workers, is_shard=is_shard)

    def _last_finished_s(self, workers: set[str], *, is_shard: bool) -> float:
        """Return the last time at which one of them finished such work, seconds.

        A finished plan does not count for shards: it proves nothing about mining.
        """
        kinds = (True,) if is_shard else (False, True)
        each = (self._finished.get((who, kind), -math.inf) for who in workers for kind in kinds)
        return max(each, default=-math.inf)

    def _last_died_s(self, workers: set[str], matters: Callable[[Work], bool]) -> float:
        return max(
            (
                death.at_s
                for death in self._deaths
                if death.worker_id in workers and matters(death.work)
            ),
            default=-math.inf,
        )


def pardon(connection: Connection, work: Work) -> None:
    """Delete the deaths on this work, so that it is tried as if for the first time."""
    connection.execute(
        update(LEASES)
        .where(
            LEASES.c.log_id == work.log_id,
            LEASES.c.revision == work.revision,
            LEASES.c.pipeline_version == work.pipeline_version,
            LEASES.c.shard == work.shard,
            LEASES.c.ended_by.in_(DEATHS),
        )
        .values(ended_by=PARDONED)
    )
