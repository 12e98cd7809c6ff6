"""How far each revision of each log is under one pipeline version: what a dry run need not mine."""

import json
from collections import defaultdict
from dataclasses import dataclass
from typing import Any, Final, Literal

from sqlalchemy import Connection, Row, select

from service.store.tables import PLANS, SHARDS
from service.store.work_items import OPEN, WorkState

LogStanding = Literal["new", "changed", "anew", "in part", "mined", "refused", "parked"]
"""Never mined here; mined as other objects; mined, but not by this pipeline version; mined in part;
nothing left; cannot be mined; planning is given up. A run mines all of the first three."""


@dataclass(frozen=True, slots=True)
class Standing:
    """One log as it lies in the bucket, and what a state knows of it.

    Attributes:
        standing: In a word.
        left_share: Share of its bytes that a run would mine, 0 to 1.
        frames: Frames mined under this version.
        parked: Plans and shards of it that are not tried again.
    """

    standing: LogStanding
    left_share: float = 1.0
    frames: int = 0
    parked: int = 0


class Standings:
    """What a state knows under one pipeline version."""

    def __init__(self, connection: Connection, pipeline_version: str) -> None:
        """Read it, once.

        Args:
            connection: To read from.
            pipeline_version: The one that would mine.
        """
        self._known: dict[tuple[str, str], Standing] = {}
        self._mined: set[tuple[str, str]] = set()
        """Planned under another version."""
        self._mined_logs: set[str] = set()
        """Planned under any, as whatever objects."""
        shards = _shards(connection, pipeline_version)
        plans = select(
            PLANS.c.log_id, PLANS.c.revision, PLANS.c.pipeline_version, PLANS.c.state
        ).where(PLANS.c.state.in_((WorkState.DONE, WorkState.REFUSED, WorkState.PARKED)))
        for plan in connection.execute(plans):
            key = (plan.log_id, plan.revision)
            if plan.state == WorkState.DONE:
                self._mined_logs.add(plan.log_id)
                if plan.pipeline_version != pipeline_version:
                    self._mined.add(key)
            if plan.pipeline_version == pipeline_version:
                self._known[key] = _standing(plan.state, shards[key])

    def of(self, log_id: str, revision: str) -> Standing:
        """Say how far a log is that lies in the bucket as this revision."""
        known = self._known.get((log_id, revision))
        if known is not None and known.left_share < 1.0:
            return known
        if (log_id, revision) in self._mined:
            return Standing("anew")
        if known is None and log_id in self._mined_logs:
            return Standing("changed")
        return Standing("new")


def _shards(
    connection: Connection, pipeline_version: str
) -> defaultdict[tuple[str, str], list[Row[Any]]]:
    found: defaultdict[tuple[str, str], list[Any]] = defaultdict(list)
    columns = (SHARDS.c[name] for name in ("log_id", "revision", "state", "frames", "shard"))
    for row in connection.execute(
        select(*columns).where(SHARDS.c.pipeline_version == pipeline_version)
    ):
        found[row.log_id, row.revision].append(row)
    return found


def _standing(plan_state: str, shards: list[Row[Any]]) -> Standing:
    if plan_state == WorkState.REFUSED:
        return Standing("refused", left_share=0.0)
    if plan_state == WorkState.PARKED:
        return Standing("parked", left_share=0.0, parked=1)
    left = _needed_bytes(row for row in shards if row.state in _LEFT)
    share = left / max(1, _needed_bytes(shards)) if left else 0.0
    return Standing(
        "in part" if share else "mined",
        left_share=share,
        frames=sum(row.frames for row in shards),
        parked=sum(row.state == WorkState.PARKED for row in shards),
    )


def _needed_bytes(shards: Any) -> int:
    return sum(max(1, json.loads(row.shard)["needed_bytes"]) for row in shards)


_LEFT: Final = (*OPEN, WorkState.CANCELLED)
"""What is cancelled is taken up again when its revision is listed."""
