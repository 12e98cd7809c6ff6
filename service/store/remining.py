"""Mining again of what an earlier pipeline version has mined: order, canary share and budget.

New logs come first, then scores that are computed again, then logs that are mined again: a canary
share, those with selected or judged scenes, the rest by the time of their newest scene. The order
is a column of plans and shards, `turn`; a claim takes turns below a limit.
"""

import hashlib
import json
import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from sqlalchemy import (
    ColumnElement,
    Connection,
    Select,
    Table,
    and_,
    exists,
    func,
    insert,
    literal,
    select,
    update,
)

from schemas.arrays import NS_PER_S
from service.curation.priorities import Priorities
from service.store.lanes import Lanes
from service.store.tables import (
    PIPELINES,
    PLANS,
    RECORDINGS,
    SCENES,
    SELECTION_SCENES,
    SHARDS,
    VERDICTS,
)
from service.store.turns import LAST_LANE, NO_LIMIT, Kind, lane_of, turn_of
from service.store.work_items import OPEN, WorkState

Mode = Literal["newest", "selected", "none"]
"""Logs that are mined again. `newest`: all, the newest first. `selected`: those with selected or
judged scenes. `none`: no log; the scenes of the version before stay.
"""

DAY_S: Final = 86_400.0
HOUR_S: Final = 3600.0

RESTS_FROM: Final = Kind.CANARY.first_turn
"""Turn from which work waits while the budget is spent: everything that is mined again."""

LIMIT_INTERVAL_S: Final = 2.0
"""Interval at which budget and canary share are read, seconds."""


@dataclass(frozen=True, slots=True)
class ReminingPolicy:
    """Choice of the logs that are mined again, and their budget of a day.

    Attributes:
        mode: Logs that are mined again.
        core_hours_a_day: Budget of a day in hours of one core; 0: no limit. Leases that are held
            when it is spent are finished.
        canary_share: Share of the logs that are mined before the others, 0 to 1.
        priorities: Order of vehicles and folders, and how many leases each holds at most.
    """

    mode: Mode = "newest"
    core_hours_a_day: float = 0.0
    canary_share: float = 0.0
    priorities: Priorities = field(default_factory=Priorities)

    def admits(self, table: Table) -> ColumnElement[bool]:
        """Return true for work that is mined, whenever its turn comes."""
        if self.mode == "newest":
            return literal(True)
        if self.mode == "none":
            return table.c.turn < Kind.CANARY.first_turn
        return table.c.turn < Kind.REST.first_turn


class Turns:
    """Turns in which work is claimed now, by pipeline version.

    Attributes:
        policy: Order of logs, and choice of those that are mined again.
        lanes: Lanes by its priorities.
    """

    def __init__(self, policy: ReminingPolicy) -> None:
        """Keep the policy."""
        self.policy, self.lanes = policy, Lanes(policy.priorities)
        self._known: dict[str, tuple[float, int]] = {}
        """Time and value of the last limit."""

    def open(
        self, connection: Connection, pipeline_version: str, *, now_s: float
    ) -> Iterator[tuple[int, int]]:
        """Yield the stretches of turns of a version that may be claimed, in the order of claims.

        The limit by budget and canary share is read at intervals.
        """
        at_s, limit = self._known.get(pipeline_version, (-math.inf, 0))
        if abs(now_s - at_s) >= LIMIT_INTERVAL_S:
            limit = limit_of(connection, pipeline_version, self.policy, now_s=now_s)
            self._known[pipeline_version] = now_s, limit
        return self.lanes.open(connection, below=limit)


def seed_plans(
    connection: Connection,
    pipeline_version: str,
    policy: ReminingPolicy,
    lane_of_log: Callable[[str], int] | None = None,
) -> None:
    """Create a plan to be made for every current recording without one under this version.

    Recordings that no other version has planned are new. The others are mined again in their turn.

    Args:
        connection: In a transaction that writes.
        pipeline_version: The version.
        policy: Choice of the logs that are mined again.
        lane_of_log: Returns the lane of a log id; None: no log has a priority.
    """
    others = select(PIPELINES.c.ordinal).where(PIPELINES.c.pipeline_version != pipeline_version)
    has_others = connection.execute(others.limit(1)).first() is not None
    if has_others and (again := connection.execute(_to_mine_again(pipeline_version)).all()):
        _seed_again(connection, pipeline_version, policy, again, lane_of_log or _last_lane)
    if lane_of_log is None:
        values = _plan_values(pipeline_version)
        new = _without_plan(pipeline_version, *values.values())
        connection.execute(insert(PLANS).from_select(list(values), new))
    else:
        _seed_new(connection, pipeline_version, lane_of_log)
    _follow_mode(connection, pipeline_version, policy)


def limit_of(
    connection: Connection, pipeline_version: str, policy: ReminingPolicy, *, now_s: float
) -> int:
    """Return the turn below which work may be claimed now."""
    if budget_is_spent(policy, spent_s(connection, pipeline_version, now_s=now_s)):
        return RESTS_FROM
    for table in (PLANS, SHARDS):
        canary = select(table.c.log_id).where(
            table.c.pipeline_version == pipeline_version,
            table.c.state.in_(OPEN),
            table.c.turn >= Kind.CANARY.first_turn,
            table.c.turn < Kind.CHOSEN.first_turn,
        )
        if connection.execute(canary.limit(1)).first() is not None:
            return Kind.CHOSEN.first_turn
    return NO_LIMIT


def budget_is_spent(policy: ReminingPolicy, spent: float) -> bool:
    """Return true if mining again has taken its budget of the last day, in seconds of a core."""
    return 0 < policy.core_hours_a_day * HOUR_S <= spent


def spent_s(connection: Connection, pipeline_version: str, *, now_s: float) -> float:
    """Return the seconds of a core that mining again has taken within the last day."""
    spent: float = connection.execute(
        select(func.coalesce(func.sum(SHARDS.c.mined_s), 0.0)).where(
            SHARDS.c.pipeline_version == pipeline_version,
            SHARDS.c.committed_s > now_s - DAY_S,
            SHARDS.c.committed_s <= now_s + DAY_S,  # later ones: of a clock that was set back since
            SHARDS.c.turn >= Kind.CANARY.first_turn,
        )
    ).scalar_one()
    return float(spent)


def turn_of_log(connection: Connection, log_id: str, *, newest_s: float, turn: int) -> int:
    """Return the turn in which one log is mined again, after its scores could not be computed.

    Args:
        connection: In a transaction.
        log_id: The log.
        newest_s: Its time, seconds since the Unix epoch.
        turn: The turn of its scores, in the same lane.
    """
    kind = Kind.CHOSEN if log_id in _chosen_logs(connection) else Kind.REST
    return turn_of(kind, newest_s=newest_s, lane=lane_of(turn))


def _to_mine_again(pipeline_version: str) -> Select[Any]:
    """Select recordings without a plan under this version that another version has planned."""
    mined = exists().where(
        PLANS.c.log_id == RECORDINGS.c.log_id,
        PLANS.c.revision == RECORDINGS.c.revision,
        PLANS.c.pipeline_version != pipeline_version,
        PLANS.c.state == WorkState.DONE,
    )
    return _without_plan(pipeline_version, RECORDINGS.c.log_id, RECORDINGS.c.revision).where(mined)


def _without_plan(pipeline_version: str, *columns: Any) -> Select[Any]:
    has_plan = exists().where(
        PLANS.c.log_id == RECORDINGS.c.log_id,
        PLANS.c.revision == RECORDINGS.c.revision,
        PLANS.c.pipeline_version == pipeline_version,
    )
    return select(*columns).where(RECORDINGS.c.is_current, RECORDINGS.c.same_as == "", ~has_plan)


def _seed_again(
    connection: Connection,
    pipeline_version: str,
    policy: ReminingPolicy,
    again: Collection[Any],
    lane_of_log: Callable[[str], int],
) -> None:
    newest_ns: dict[str, int] = {
        row.log_id: row.newest_ns
        for row in connection.execute(
            select(SCENES.c.log_id, func.max(SCENES.c.start_ns).label("newest_ns"))
            .where(SCENES.c.is_current)
            .group_by(SCENES.c.log_id)
        )
    }
    chosen = _chosen_logs(connection)
    waiting = _plan_facts(pipeline_version)
    rows = []
    for log_id, revision in again:
        kind = Kind.CHOSEN if log_id in chosen else Kind.REST
        is_drawn = policy.mode == "newest" or kind is Kind.CHOSEN
        if is_drawn and _place(log_id, pipeline_version) < policy.canary_share:
            kind = Kind.CANARY
        newest_s = newest_ns.get(log_id, 0) / NS_PER_S
        turn = turn_of(kind, newest_s=newest_s, lane=lane_of_log(log_id))
        rows.append(waiting | {"log_id": log_id, "revision": revision, "turn": turn})
    connection.execute(insert(PLANS), rows)


def _seed_new(
    connection: Connection, pipeline_version: str, lane_of_log: Callable[[str], int]
) -> None:
    """Insert plans of new recordings, each in the lane of its log."""
    columns = (RECORDINGS.c.log_id, RECORDINGS.c.revision)
    waiting = _plan_facts(pipeline_version)
    rows = [
        waiting
        | {
            "log_id": log_id,
            "revision": revision,
            "turn": turn_of(Kind.NEW, lane=lane_of_log(log_id)),
        }
        for log_id, revision in connection.execute(_without_plan(pipeline_version, *columns))
    ]
    if rows:
        connection.execute(insert(PLANS), rows)


def _last_lane(_: str) -> int:
    return LAST_LANE


def _place(log_id: str, pipeline_version: str) -> float:
    """Return a place from 0 to 1, the same on every service; another version draws others."""
    digest = hashlib.sha256(f"{pipeline_version}/{log_id}".encode()).digest()
    return int.from_bytes(digest[:4], "big") / 2**32


def _follow_mode(connection: Connection, pipeline_version: str, policy: ReminingPolicy) -> None:
    """Keep what the mode leaves out, and take up what it admits: the mode may have changed."""
    if policy.mode == "selected":
        _choose_kept(connection, pipeline_version)
    for table in (PLANS, SHARDS):
        admitted, ours = policy.admits(table), table.c.pipeline_version == pipeline_version
        connection.execute(
            update(table)
            .where(ours, table.c.state == WorkState.KEPT, admitted)
            .values(state=WorkState.READY)
        )
        if policy.mode != "newest":
            connection.execute(
                update(table)
                .where(ours, table.c.state == WorkState.READY, ~admitted)
                .values(state=WorkState.KEPT)
            )


def _choose_kept(connection: Connection, pipeline_version: str) -> None:
    """Give kept logs the turn of chosen ones that have become so since."""
    is_kept = and_(PLANS.c.pipeline_version == pipeline_version, PLANS.c.state == WorkState.KEPT)
    kept = set(connection.execute(select(PLANS.c.log_id).where(is_kept)).scalars())
    for log_id in sorted(kept & _chosen_logs(connection)) if kept else ():
        step = Kind.REST.first_turn - Kind.CHOSEN.first_turn
        connection.execute(
            update(PLANS)
            .where(is_kept, PLANS.c.log_id == log_id, PLANS.c.turn >= Kind.REST.first_turn)
            .values(turn=PLANS.c.turn - step)
        )


def _chosen_logs(connection: Connection) -> set[str]:
    """Return logs with a scene that is selected or judged."""
    selected = connection.execute(select(SELECTION_SCENES.c.scene)).scalars()
    logs = {str(json.loads(scene)["log_id"]) for scene in selected}
    judged = select(VERDICTS.c.scene_id).where(VERDICTS.c.is_current).distinct()
    return logs | {scene_id.rsplit("/", 2)[0] for scene_id in connection.execute(judged).scalars()}


def _plan_values(pipeline_version: str) -> dict[str, Any]:
    """Return the columns of a plan to be made, for a select over recordings."""
    facts = {name: literal(value) for name, value in _plan_facts(pipeline_version).items()}
    return {"log_id": RECORDINGS.c.log_id, "revision": RECORDINGS.c.revision, **facts}


def _plan_facts(pipeline_version: str) -> dict[str, str | int | float]:
    """Return the columns of a plan to be made, apart from its recording."""
    return {
        "pipeline_version": pipeline_version,
        "state": WorkState.READY.value,
        "attempts": 0,
        "error": "",
        "ready_at_s": 0.0,
        "lease_id": "",
        "vehicle": "unknown",
        "date": "unknown",
        "software_version": "unknown",
        "lidar_topics": "[]",
        "digest": "",
        "range_reads": 0,
        "bytes_read": 0,
        "truncated_parts": 0,
        "turn": Kind.NEW.first_turn,
        "inherited_from": "",
    }
