"""Progress of each revision of each log under one pipeline version, for dry runs."""

import json
from collections import defaultdict
from dataclasses import dataclass
from typing import Any, Final, Literal

from sqlalchemy import Connection, Row, select

from schemas.layers import Layers
from service.store.rescored_shards import same_but_for_scores
from service.store.tables import PLANS, SHARDS
from service.store.work_items import OPEN, WorkState

LogStanding = Literal["new", "changed", "anew", "in part", "scores", "mined", "refused", "parked"]
"""State of a log in words.

`new`: never mined here. `changed`: mined with other objects. `anew`: mined, but not by this
pipeline version. `in part`: mined in part. `scores`: mined by a version that differs in the score
alone, so that a run computes scores again. `mined`: nothing left. `refused`: cannot be mined.
`parked`: planning was given up. A run mines all of the first three.
"""


@dataclass(frozen=True, slots=True)
class Standing:
    """One log in the bucket, and its progress in a state.

    Attributes:
        standing: State in words.
        left_share: Share of its bytes that a run would mine, 0 to 1.
        frames: Frames mined under this version.
        parked: Plans and shards of it that are not retried.
    """

    standing: LogStanding
    left_share: float = 1.0
    frames: int = 0
    parked: int = 0


class Standings:
    """Progress of all logs under one pipeline version."""

    def __init__(
        self, connection: Connection, pipeline_version: str, layers: Layers | None = None
    ) -> None:
        """Read the progress, once.

        Args:
            connection: To read from.
            pipeline_version: Version that would mine.
            layers: Its layers; None: not known, so no log has its scores computed again.
        """
        self._known: dict[tuple[str, str], Standing] = {}
        self._mined: set[tuple[str, str]] = set()
        """Revisions planned under another version."""
        self._mined_logs: set[str] = set()
        """Logs planned under any version, with any objects."""
        self._inherited: dict[tuple[str, str], Standing] = {}
        """Revisions planned by a version that differs in the score alone."""
        versions = same_but_for_scores(connection, pipeline_version, layers) if layers else []
        shards = {each: _shards(connection, each) for each in (pipeline_version, *versions)}
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
                self._known[key] = _standing(plan.state, shards[pipeline_version][key])
        for version in reversed(versions):  # the newest counts
            self._inherit(connection, version, shards[version])

    def of(self, log_id: str, revision: str) -> Standing:
        """Return the progress of a log in the bucket at this revision."""
        known = self._known.get((log_id, revision))
        if known is not None and known.left_share < 1.0:
            return known
        if inherited := self._inherited.get((log_id, revision)):
            return inherited
        if (log_id, revision) in self._mined:
            return Standing("anew")
        if known is None and log_id in self._mined_logs:
            return Standing("changed")
        return Standing("new")

    def _inherit(
        self,
        connection: Connection,
        version: str,
        shards: defaultdict[tuple[str, str], list[Row[Any]]],
    ) -> None:
        plans = select(PLANS.c.log_id, PLANS.c.revision, PLANS.c.state).where(
            PLANS.c.pipeline_version == version,
            PLANS.c.state.in_((WorkState.DONE, WorkState.REFUSED)),
        )
        for plan in connection.execute(plans):
            found = _inherited(plan.state, shards[plan.log_id, plan.revision])
            self._inherited[plan.log_id, plan.revision] = found


def _shards(
    connection: Connection, pipeline_version: str
) -> defaultdict[tuple[str, str], list[Row[Any]]]:
    found: defaultdict[tuple[str, str], list[Any]] = defaultdict(list)
    columns = (SHARDS.c[name] for name in _COLUMNS)
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
    left = _needed_bytes(row for row in shards if row.state in _LEFT and not row.rescored_from)
    share = left / max(1, _needed_bytes(shards)) if left else 0.0
    is_scored = not any(row.state in _LEFT and row.rescored_from for row in shards)
    return Standing(
        "in part" if share else "mined" if is_scored else "scores",
        left_share=share,
        frames=sum(row.frames for row in shards),
        parked=sum(row.state == WorkState.PARKED for row in shards),
    )


def _inherited(plan_state: str, shards: list[Row[Any]]) -> Standing:
    """Return the progress of a log whose mined shards get their scores computed again."""
    if plan_state == WorkState.REFUSED:
        return Standing("refused", left_share=0.0)
    left = _needed_bytes(row for row in shards if row.state != WorkState.DONE)
    share = left / max(1, _needed_bytes(shards)) if left else 0.0
    return Standing(
        "in part" if share else "scores",
        left_share=share,
        frames=sum(row.frames for row in shards),
    )


def _needed_bytes(shards: Any) -> int:
    return sum(max(1, json.loads(row.shard)["needed_bytes"]) for row in shards)


_COLUMNS: Final = ("log_id", "revision", "state", "frames", "shard", "rescored_from")

_LEFT: Final = (*OPEN, WorkState.CANCELLED)
"""States of work that a run would do; cancelled work is resumed when its revision is listed."""
