"""Shards whose scores are computed again: another version differs in the score layer alone."""

from typing import Any, Final

from sqlalchemy import (
    Connection,
    Select,
    Table,
    and_,
    bindparam,
    case,
    exists,
    insert,
    literal,
    or_,
    select,
)

from schemas.work import Layers, ManifestEntry, RescoredShard
from service.store.statements import Statement
from service.store.tables import DAMAGE, PIPELINES, PLANS, RECORDINGS, SCENES, SHARDS
from service.store.turns import Kind
from service.store.work_items import TAKEN_AND_GIVEN, Work, WorkState


def inherit_plans(connection: Connection, pipeline_version: str, layers: Layers) -> None:
    """Copy plans and shards of versions with the same labels and contradictions.

    A shard that such a version has mined is scored again, the others are mined. Recordings that
    have a plan already are left alone.
    """
    for source in same_but_for_scores(connection, pipeline_version, layers):
        of_source = and_(
            PLANS.c.pipeline_version == source,
            PLANS.c.state.in_((WorkState.DONE, WorkState.REFUSED)),
        )
        if connection.execute(_missing(pipeline_version, of_source).limit(1)).first() is None:
            continue
        _copy(
            connection,
            PLANS,
            _missing(pipeline_version, of_source, *_columns(PLANS, pipeline_version, source)),
        )
        shards = _columns(SHARDS, pipeline_version, source)
        inherited = PLANS.alias("inherited")
        there = SHARDS.alias("there")
        of_copied_plan = and_(
            inherited.c.log_id == SHARDS.c.log_id,
            inherited.c.revision == SHARDS.c.revision,
            inherited.c.pipeline_version == pipeline_version,
            inherited.c.inherited_from == source,
        )
        has_shard = exists().where(
            there.c.log_id == SHARDS.c.log_id,
            there.c.revision == SHARDS.c.revision,
            there.c.pipeline_version == pipeline_version,
            there.c.name == SHARDS.c.name,
        )
        _copy(
            connection,
            SHARDS,
            select(*shards)
            .join(inherited, of_copied_plan)
            .where(SHARDS.c.pipeline_version == source, ~has_shard),
        )
        _copy_plan_damage(connection, pipeline_version, source)


def rescored_shard(connection: Connection, work: Work, row: Any) -> RescoredShard:
    """Return the scenes of a shard as the version, or the other log, that has them committed them.

    Args:
        connection: In a transaction.
        work: The shard.
        row: Its row: `rescored_from`, `taken_from_log` and `taken_from_revision`.
    """
    rows = _SCENES.rows(
        connection,
        {
            "at_log": row.taken_from_log or work.log_id,
            "at_revision": row.taken_from_revision or work.revision,
            "at_pipeline": row.rescored_from,
            "at_shard": work.shard,
        },
    )
    scenes = tuple(ManifestEntry(scene_id=row.scene_id, sha256=row.sha256) for row in rows)
    return RescoredShard(
        pipeline_version=row.rescored_from, scenes=scenes, log_id=row.taken_from_log
    )


def mined_before(connection: Connection, work: Work, row: Any) -> dict[str, Any]:
    """Return frames and points of a shard that is scored again, and copy its damage."""
    log_id = row.taken_from_log or work.log_id
    revision = row.taken_from_revision or work.revision
    mined = connection.execute(
        select(SHARDS.c.frames, SHARDS.c.points, SHARDS.c.adopted_from).where(
            SHARDS.c.log_id == log_id,
            SHARDS.c.revision == revision,
            SHARDS.c.pipeline_version == row.rescored_from,
            SHARDS.c.name == work.shard,
        )
    ).one()
    named = {
        "log_id": work.log_id,
        "revision": work.revision,
        "pipeline_version": work.pipeline_version,
    }
    columns = [column for column in DAMAGE.c if column.name not in named]
    connection.execute(
        insert(DAMAGE).from_select(
            [*named, *(column.name for column in columns)],
            select(*map(literal, named.values()), *columns).where(
                DAMAGE.c.log_id == log_id,
                DAMAGE.c.revision == revision,
                DAMAGE.c.pipeline_version == row.rescored_from,
                DAMAGE.c.shard == work.shard,
            ),
        )
    )
    return {"frames": mined.frames, "points": mined.points}


def same_but_for_scores(connection: Connection, pipeline_version: str, layers: Layers) -> list[str]:
    """Return the other versions with the same labels and contradictions, the newest first."""
    found = connection.execute(
        select(PIPELINES.c.pipeline_version)
        .where(
            PIPELINES.c.pipeline_version != pipeline_version,
            PIPELINES.c.labels == layers.labels,
            PIPELINES.c.contradictions == layers.contradictions,
        )
        .order_by(PIPELINES.c.ordinal.desc())
    )
    return list(found.scalars())


def _missing(pipeline_version: str, of_source: Any, *columns: Any) -> Select[Any]:
    """Select plans of a source for current recordings without a plan under this version."""
    own = PLANS.alias("own")
    has_plan = exists().where(
        own.c.log_id == PLANS.c.log_id,
        own.c.revision == PLANS.c.revision,
        own.c.pipeline_version == pipeline_version,
    )
    is_current = and_(
        RECORDINGS.c.log_id == PLANS.c.log_id,
        RECORDINGS.c.revision == PLANS.c.revision,
        RECORDINGS.c.is_current,
        RECORDINGS.c.same_as == "",
    )
    return (
        select(*(columns or (PLANS.c.log_id,)))
        .join(RECORDINGS, is_current)
        .where(of_source, ~has_plan)
    )


def _columns(table: Table, pipeline_version: str, source: str) -> list[Any]:
    """Return the columns of copied rows, in the order of the table."""
    values: dict[str, Any] = {"pipeline_version": literal(pipeline_version)}
    if table is PLANS:
        values["inherited_from"] = literal(source)
    else:
        is_mined = SHARDS.c.state == WorkState.DONE
        values |= {
            "state": literal(WorkState.READY.value),
            "attempts": literal(0),
            "error": literal(""),
            "ready_at_s": literal(0.0),
            "lease_id": literal(""),
            "adopted_from": literal(""),
            "taken_from_log": literal(""),
            "taken_from_revision": literal(""),
            "rescored_from": case((is_mined, literal(source)), else_=literal("")),
            "turn": case((is_mined, literal(Kind.RESCORED.first_turn)), else_=SHARDS.c.turn),
            "mined_s": literal(0.0),
            **{name: _EMPTY.get(name, literal(0)) for name in TAKEN_AND_GIVEN},
        }
    return [values.get(column.name, column) for column in table.c]


_EMPTY: Final = {"digest": literal(""), "committed_s": literal(0.0), "stage_s": literal("{}")}


def _copy(connection: Connection, table: Table, rows: Select[Any]) -> None:
    connection.execute(insert(table).from_select([column.name for column in table.c], rows))


def _copy_plan_damage(connection: Connection, pipeline_version: str, source: str) -> None:
    there = DAMAGE.alias("there")
    inherited = and_(
        PLANS.c.log_id == DAMAGE.c.log_id,
        PLANS.c.revision == DAMAGE.c.revision,
        PLANS.c.pipeline_version == pipeline_version,
        PLANS.c.inherited_from == source,
    )
    is_copied = exists().where(
        there.c.log_id == DAMAGE.c.log_id,
        there.c.revision == DAMAGE.c.revision,
        there.c.pipeline_version == pipeline_version,
        there.c.shard == "",
        there.c.position == DAMAGE.c.position,
    )
    columns = [
        literal(pipeline_version) if column.name == "pipeline_version" else column
        for column in DAMAGE.c
    ]
    _copy(
        connection,
        DAMAGE,
        select(*columns)
        .join(PLANS, inherited)
        .where(DAMAGE.c.pipeline_version == source, DAMAGE.c.shard == "", ~is_copied),
    )


_MINED: Final = SHARDS.alias("mined")
_SCENES: Final = Statement(
    select(SCENES.c.scene_id, SCENES.c.sha256)
    .join(
        _MINED,
        and_(
            _MINED.c.log_id == SCENES.c.log_id,
            _MINED.c.pipeline_version == SCENES.c.pipeline_version,
            _MINED.c.name == SCENES.c.shard,
            or_(
                and_(_MINED.c.adopted_from == "", SCENES.c.revision == _MINED.c.revision),
                SCENES.c.revision == _MINED.c.adopted_from,
            ),
        ),
    )
    .where(
        _MINED.c.log_id == bindparam("at_log"),
        _MINED.c.revision == bindparam("at_revision"),
        _MINED.c.pipeline_version == bindparam("at_pipeline"),
        _MINED.c.name == bindparam("at_shard"),
    )
    .order_by(SCENES.c.start_ns)
)
