"""Lanes of claims: the priority of each log in its turn, and the leases that each lane holds."""

from collections.abc import Callable, Iterator
from typing import Any, Final

from sqlalchemy import Connection, Select, Table, func, select, update

from service.curation.priorities import Priorities
from service.store.statements import Statement
from service.store.tables import LEASES, PLANS, SHARDS
from service.store.turns import FIRST_TURN, LAST_LANE, in_lane, stretches
from service.store.work_items import OPEN, WorkState

UNKNOWN_VEHICLE: Final = "unknown"


class Lanes:
    """Lanes by the priorities of the settings; without any, every log is in the last lane."""

    def __init__(self, priorities: Priorities | None = None) -> None:
        """Keep the priorities."""
        self._priorities = priorities or Priorities()

    def lane(self, log_id: str, vehicle: str = UNKNOWN_VEHICLE) -> int:
        """Return the lane of a log."""
        if not self._priorities:
            return LAST_LANE
        place = self._priorities.place_of(log_id, vehicle)
        return place if place < len(self._priorities.entries) else LAST_LANE

    def by_log(self, connection: Connection) -> Callable[[str], int] | None:
        """Return the lane by log id, with the vehicles that any plan has found; None: no lanes."""
        if not self._priorities:
            return None
        found = select(PLANS.c.log_id, PLANS.c.vehicle).where(PLANS.c.vehicle != UNKNOWN_VEHICLE)
        vehicles = {row.log_id: row.vehicle for row in connection.execute(found.distinct())}
        return lambda log_id: self.lane(log_id, vehicles.get(log_id, UNKNOWN_VEHICLE))

    def open(self, connection: Connection, *, below: int) -> Iterator[tuple[int, int]]:
        """Yield the stretches of turns that may be claimed now, in the order of claims.

        Lanes that hold their share of the leases come once more at the end, since a share bounds
        them only while other work waits.
        """
        if not self._priorities.has_limits:
            yield FIRST_TURN, below
            return
        held = {row.lane: row.leases for row in _HELD.rows(connection, {})}
        full = self._priorities.full(held)
        yield from stretches(full, below=below)
        if by_share := full - self._priorities.full(held, strictly=True):
            yield from stretches((), below=below, of=by_share)

    def follow(self, connection: Connection, pipeline_version: str) -> None:
        """Put open work and held leases into the lanes of these priorities: they may be others."""
        lane_of = self.by_log(connection) or (lambda _: LAST_LANE)
        for table in (PLANS, SHARDS):
            waiting = connection.execute(_open_turns(table, pipeline_version)).all()
            for log_id, turn in {(row.log_id, row.turn) for row in waiting}:
                moved = in_lane(turn, lane_of(log_id))
                if moved != turn:
                    connection.execute(
                        update(table)
                        .where(
                            table.c.log_id == log_id,
                            table.c.pipeline_version == pipeline_version,
                            table.c.turn == turn,
                            table.c.state.in_(_MOVED),
                        )
                        .values(turn=moved)
                    )
        held = select(LEASES.c.lease_id, LEASES.c.log_id, LEASES.c.lane).where(LEASES.c.is_held)
        for lease in connection.execute(held).all():
            if lane_of(lease.log_id) != lease.lane:
                connection.execute(
                    update(LEASES)
                    .where(LEASES.c.lease_id == lease.lease_id)
                    .values(lane=lane_of(lease.log_id))
                )


_MOVED: Final = (*OPEN, WorkState.KEPT)


def _open_turns(table: Table, pipeline_version: str) -> Select[Any]:
    return select(table.c.log_id, table.c.turn).where(
        table.c.pipeline_version == pipeline_version, table.c.state.in_(_MOVED)
    )


_HELD: Final = Statement(
    select(LEASES.c.lane, func.count().label("leases"))
    .where(LEASES.c.is_held)
    .group_by(LEASES.c.lane)
)
