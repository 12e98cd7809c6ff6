"""Which pipeline version's scenes are current where several have mined the same stretch."""

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
    """Let the newest pipeline version have each stretch of a log that it has mined.

    Args:
        connection: In a transaction that writes; the shard is noted as done in it.
        work: The shard whose scenes are about to be stored.
        row: Its row.
        starts_ns: Id to start of those scenes.

    Returns:
        Ids of those that become current; what they replace is withdrawn.
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
    """Ids of scenes in stretches that one of these versions has mined.

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
    """Withdraw what older pipeline versions made of the stretch that this shard covers.

    With the last shard of the log, everything older goes: another grid or another choice of lidar
    may have left scenes that no shard of ours covers.
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
