"""Entry of a pipeline version into the ledger: its plans, inherited or to be made."""

from dataclasses import dataclass

import structlog
from sqlalchemy import Connection, select

from schemas.work import Layers
from service.store.recordings import register_pipeline
from service.store.remining import Mode, Turns, seed_plans
from service.store.rescored_shards import inherit_plans
from service.store.tables import PIPELINES

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class NewVersion:
    """A version that has taken the place of the newest.

    Attributes:
        version: The version.
        before: The newest before.
        layers: Layers in which they differ.
    """

    version: str
    before: str
    layers: tuple[str, ...]

    def tell(self, *, mode: Mode) -> None:
        """Log what it means for the fleet."""
        facts = {
            "pipeline_version": self.version,
            "before": self.before,
            "layers": list(self.layers),
        }
        if self.layers == ("score",):
            log.warning("new pipeline version: scores are computed again", **facts)
        else:
            log.warning("new pipeline version: logs are mined again", remine=mode, **facts)


def enter_version(
    connection: Connection,
    pipeline_version: str,
    layers: Layers | None,
    turns: Turns,
    *,
    first: bool,
) -> NewVersion | None:
    """Register a version, and give every current recording a plan under it.

    Args:
        connection: In a transaction that writes.
        pipeline_version: The version of a worker that claims.
        layers: Its layers; None: it states none, and inherits nothing.
        turns: Order of logs, and choice of those that are mined again.
        first: True for the first entry since the start, when priorities may be others.

    Returns:
        The version, if it has just taken the place of another as the newest.
    """
    before = register_pipeline(connection, pipeline_version, layers)
    if layers is not None:
        inherit_plans(connection, pipeline_version, layers)
    lane_of_log = turns.lanes.by_log(connection)
    seed_plans(connection, pipeline_version, turns.policy, lane_of_log)
    if first:
        turns.lanes.follow(connection, pipeline_version)
    if not before:
        return None
    return NewVersion(pipeline_version, before, _changed(connection, pipeline_version, before))


def _changed(connection: Connection, pipeline_version: str, before: str) -> tuple[str, ...]:
    """Return the layers in which two versions differ; all where one states none."""
    rows = {
        row["pipeline_version"]: row
        for row in connection.execute(
            select(PIPELINES).where(PIPELINES.c.pipeline_version.in_((pipeline_version, before)))
        ).mappings()
    }
    new, old = rows[pipeline_version], rows[before]
    return tuple(name for name in Layers.model_fields if not new[name] or new[name] != old[name])
