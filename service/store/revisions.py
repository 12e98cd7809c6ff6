"""Choice of the revision with current scenes, for a recording that was replaced or returned."""

from sqlalchemy import ColumnElement, Connection, and_, exists, false, func, or_, select

from service.store.events import restore, withdraw
from service.store.tables import PIPELINES, SCENES, SHARDS
from service.store.work_items import WorkState


def take_over(connection: Connection, *, log_id: str, revision: str) -> None:
    """Make one revision the source of every current scene of its log; withdraw those of others.

    Called when its plan is finished, refused or parked. Until then the scenes of the previous
    revision stay, since there are none yet to replace them. Of its own scenes those become current
    that no newer pipeline version has mined again.
    """
    ours = _belongs_to(log_id=log_id, revision=revision)
    beaten = _beaten(connection, log_id=log_id, revision=revision)
    coming = and_(~SCENES.c.is_current, ours, ~beaten)
    replaced = frozenset(connection.execute(select(SCENES.c.scene_id).where(coming)).scalars())
    going = and_(SCENES.c.log_id == log_id, ~ours)
    withdraw(connection, going, by="revision", replaced=replaced)
    withdraw(connection, and_(ours, beaten), by="pipeline", replaced=replaced)
    restore(connection, coming)


def _belongs_to(*, log_id: str, revision: str) -> ColumnElement[bool]:
    """Return true for a scene of a revision: mined under it, or in a shard that it has adopted."""
    adopted = exists().where(
        SHARDS.c.log_id == log_id,
        SHARDS.c.revision == revision,
        SHARDS.c.pipeline_version == SCENES.c.pipeline_version,
        SHARDS.c.name == SCENES.c.shard,
        SHARDS.c.adopted_from == SCENES.c.revision,
    )
    return and_(SCENES.c.log_id == log_id, or_(SCENES.c.revision == revision, adopted))


def _beaten(connection: Connection, *, log_id: str, revision: str) -> ColumnElement[bool]:
    """Return true if a newer pipeline version has mined a scene's stretch, or all of it."""
    ordinals = {row.pipeline_version: row.ordinal for row in connection.execute(select(PIPELINES))}
    shards = connection.execute(
        select(SHARDS.c.pipeline_version, func.min(SHARDS.c.state), func.max(SHARDS.c.state))
        .where(SHARDS.c.log_id == log_id, SHARDS.c.revision == revision)
        .group_by(SHARDS.c.pipeline_version)
    ).all()
    beaten: list[ColumnElement[bool]] = [false()]
    for version, *states in shards:
        older = [each for each, ordinal in ordinals.items() if ordinal < ordinals[version]]
        if not older:
            continue
        stretch = exists().where(
            SHARDS.c.log_id == log_id,
            SHARDS.c.revision == revision,
            SHARDS.c.pipeline_version == version,
            SHARDS.c.state == WorkState.DONE,
            SHARDS.c.lidar_topic == SCENES.c.lidar_topic,
            SHARDS.c.covers_from_ns <= SCENES.c.start_ns,
            SHARDS.c.covers_to_ns > SCENES.c.start_ns,
        )
        is_older = SCENES.c.pipeline_version.in_(older)
        beaten.append(is_older if set(states) == {WorkState.DONE} else and_(is_older, stretch))
    return or_(*beaten)
