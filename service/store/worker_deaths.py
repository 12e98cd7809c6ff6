"""Who is to blame for a death: the work, or the worker that died on it; read from the leases.

A death counts against its work, unless the worker, or its whole machine, has died on other work
since it last finished something. Work that ended badly before waits for a worker that has finished
something since it last died, as long as there is one. Work on which `LeasePolicy.max_deaths`
workers died is parked, whoever they were.
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
"""How leases end whose worker is not heard of any more."""

PARDONED: Final = "pardoned"
"""How the lease of a death ended once a person has its work tried again."""


def machine_of(worker_id: str) -> str:
    """Name where a worker runs: its id without the last two parts, which are pool and place."""
    parts = worker_id.rsplit("-", 2)
    return parts[0] if len(parts) == 3 else worker_id


@dataclass(frozen=True, slots=True)
class Death:
    """A lease that ended with its worker.

    Attributes:
        worker_id: Who died.
        work: What it was working on.
        at_s: When its lease was over, seconds.
    """

    worker_id: str
    work: Work
    at_s: float


class History:
    """What became of the leases of one pipeline version, as far back as leases are kept."""

    def __init__(
        self, finished: dict[tuple[str, bool], float], deaths: Iterable[Death], heard: set[str]
    ) -> None:
        """Take what was read.

        Args:
            finished: When a worker last finished work, by its id and whether that was a shard.
            deaths: All of them.
            heard: Ids of the workers that were heard of a moment ago.
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
            version: Which.
            from_s: Whose lease ends later than this is heard of, seconds.
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
        """Whether a death on this work is likelier the fault of its worker, or of its machine."""
        mates = self._machine[machine_of(worker_id)]
        return any(self._died_elsewhere(who, work) for who in ({worker_id}, mates))

    def is_to_wait(self, worker_id: str, *, is_shard: bool) -> bool:
        """Whether work that ended badly is better left to another worker that is around."""
        return not self._is_proven(worker_id, is_shard=is_shard) and any(
            self._is_proven(other, is_shard=is_shard) for other in self._heard - {worker_id}
        )

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
        """Say when one of them last finished such work; a plan says nothing about mining."""
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
    """Forget who died on this work: it is tried as if for the first time."""
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
