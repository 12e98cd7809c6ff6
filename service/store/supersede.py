"""Choice of the pipeline version with current scenes, where several have mined the same stretch."""

from collections.abc import Mapping
from typing import Any, Final

from sqlalchemy import Connection, Row, and_, exists, select

from service.store.events import withdraw
from service.store.statements import Statement
from service.store.tables import PIPELINES, SCENES, SHARDS
from service.store.work_items import Work, WorkState


def give_way(
    connection: Connection, work: Work, row: Row[Any], starts_ns: Mapping[str, int]
) -> set[str]:
    """Make the newest pipeline version current in each stretch of a log that it has mined.

    Args:
        connection: In a transaction that writes, in which the shard is marked as done.
        work: The shard whose scenes are about to be stored.
        row: Row of that shard.
        starts_ns: Start of those scenes by id, nanoseconds since the Unix epoch.

    Returns:
        Ids of those that become current; the scenes they replace are withdrawn.
    """
    versions = {
        version.pipeline_version: version.ordinal for version in _VERSIONS.rows(connection, {})
    }
    ours = versions[work.pipeline_version]
    newer = [version for version, ordinal in versions.items() if ordinal > ours]
    older = [version for version, ordinal in versions.items() if ordinal < ours]
    current = set(starts_ns)
    if newer:
        current -= _mined(connection, work, row.lidar_topic, starts_ns, by=newer)
    if older:
        _supersede(connection, work, row, older=older, replaced=current)
    return current


def _mined(
    connection: Connection,
    work: Work,
    lidar_topic: str,
    starts_ns: Mapping[str, int],
    *,
    by: list[str],
) -> set[str]:
    """Return ids of scenes in stretches that one of these versions has mined.

    A worker of the old version may finish after one of the new, while both run.
    """
    stretches = connection.execute(
        select(SHARDS.c.covers_from_ns, SHARDS.c.covers_to_ns).where(
            SHARDS.c.log_id == work.log_id,
            SHARDS.c.revision == work.revision,
            SHARDS.c.pipeline_version.in_(by),
            SHARDS.c.lidar_topic == lidar_topic,
            SHARDS.c.state == WorkState.DONE,
        )
    ).all()
    return {
        scene_id
        for scene_id, start_ns in starts_ns.items()
        if any(start <= start_ns < end for start, end in stretches)
    }


def _supersede(
    connection: Connection, work: Work, row: Row[Any], *, older: list[str], replaced: set[str]
) -> None:
    """Withdraw the scenes of older pipeline versions in the stretch of this shard.

    With the last shard of the log all older scenes are withdrawn: another grid or another choice of
    lidar may have left scenes that no shard of this version covers.
    """
    unfinished = exists().where(
        SHARDS.c.log_id == work.log_id,
        SHARDS.c.revision == work.revision,
        SHARDS.c.pipeline_version == work.pipeline_version,
        SHARDS.c.state != WorkState.DONE,
    )
    which = and_(SCENES.c.log_id == work.log_id, SCENES.c.pipeline_version.in_(older))
    if connection.execute(select(unfinished)).scalar_one():
        which = and_(
            which,
            SCENES.c.lidar_topic == row.lidar_topic,
            SCENES.c.start_ns >= row.covers_from_ns,
            SCENES.c.start_ns < row.covers_to_ns,
        )
    withdraw(connection, which, by="pipeline", replaced=replaced)


_VERSIONS: Final = Statement(select(PIPELINES))
