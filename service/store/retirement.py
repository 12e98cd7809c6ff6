"""Queries on overlays that no current scene needs: since when, and which may be deleted."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from sqlalchemy import (
    ColumnElement,
    Connection,
    FromClause,
    Select,
    and_,
    bindparam,
    delete,
    exists,
    insert,
    or_,
    select,
    update,
)

from service.store.overview import newest_pipeline
from service.store.tables import PLANS, RECORDINGS, RETIRED_OVERLAYS, SCENES, SHARDS
from service.store.work_items import WorkState


@dataclass(frozen=True, slots=True, order=True)
class SceneOverlay:
    """Identity of one overlay, in the terms of `schemas.overlay.overlay_key`.

    Two revisions of a log may have made the same record: their scenes share it.
    """

    log_id: str
    scene_id: str
    pipeline_version: str
    sha256: str


def newly_retired(connection: Connection, *, portion: int) -> Iterator[list[SceneOverlay]]:
    """Find unused overlays that are not recorded yet."""
    known = exists().where(_same_overlay(SCENES, RETIRED_OVERLAYS))
    query = select(*_of(SCENES)).distinct()
    return _portions(
        connection, query.where(~SCENES.c.is_current, ~known, ~_is_current(SCENES)), portion
    )


def needed_again(connection: Connection, *, portion: int) -> Iterator[list[SceneOverlay]]:
    """Find recorded overlays whose scene has become current again."""
    query = select(*_of(RETIRED_OVERLAYS))
    return _portions(connection, query.where(_is_current(RETIRED_OVERLAYS)), portion)


def note_retired(connection: Connection, overlays: Sequence[SceneOverlay], *, now_s: float) -> None:
    """Record these overlays as unused from now on."""
    rows = [asdict(each) | {"since_s": now_s, "is_deleted": False} for each in overlays]
    connection.execute(insert(RETIRED_OVERLAYS), rows)


def forget(connection: Connection, overlays: Sequence[SceneOverlay]) -> None:
    """Remove these overlays from the record."""
    connection.execute(delete(RETIRED_OVERLAYS).where(_AT), _keys(overlays))


def to_delete(connection: Connection, *, before_s: float, limit: int) -> list[SceneOverlay]:
    """Find overlays that have been unused since a time, the oldest first.

    Overlays of a log with pending work are left out. A shard that is mined again may produce the
    same record as a withdrawn one, and its worker writes the overlay before it commits.
    """
    c = RETIRED_OVERLAYS.c
    found = connection.execute(
        select(*_of(RETIRED_OVERLAYS))
        .where(
            ~c.is_deleted,
            c.since_s <= before_s,
            ~_is_current(RETIRED_OVERLAYS),
            ~_is_worked_on(newest_pipeline(connection)),
        )
        .order_by(c.since_s, *_of(RETIRED_OVERLAYS))
        .limit(limit)
    )
    return [SceneOverlay(*row) for row in found]


def note_deleted(connection: Connection, overlays: Sequence[SceneOverlay]) -> None:
    """Record the deletion of these overlays."""
    connection.execute(update(RETIRED_OVERLAYS).where(_AT).values(is_deleted=True), _keys(overlays))


_NAMES: Final = ("log_id", "scene_id", "pipeline_version", "sha256")
_AT: Final = and_(*(RETIRED_OVERLAYS.c[name] == bindparam(f"at_{name}") for name in _NAMES))


def _of(table: FromClause) -> list[Any]:
    return [table.c[name] for name in _NAMES]


def _portions(
    connection: Connection, query: Select[Any], portion: int
) -> Iterator[list[SceneOverlay]]:
    """Read in portions while others write; the result is that of the moment of its start."""
    found = connection.execute(query, execution_options={"yield_per": portion})
    for rows in found.partitions():
        yield [SceneOverlay(*row) for row in rows]


def _keys(overlays: Sequence[SceneOverlay]) -> list[dict[str, str]]:
    return [{f"at_{name}": value for name, value in asdict(each).items()} for each in overlays]


def _same_overlay(one: FromClause, other: FromClause) -> ColumnElement[bool]:
    return and_(*(mine == its for mine, its in zip(_of(one), _of(other), strict=True)))


def _is_current(table: FromClause) -> ColumnElement[bool]:
    current = SCENES.alias("current_scenes")
    return exists().where(current.c.is_current, _same_overlay(current, table))


def _is_worked_on(version: str) -> ColumnElement[bool]:
    """Return true if the log of an overlay is in the bucket, with work left under this version."""
    its = and_(RECORDINGS.c.log_id == RETIRED_OVERLAYS.c.log_id, RECORDINGS.c.is_current)
    planned = exists().where(
        PLANS.c.log_id == RECORDINGS.c.log_id,
        PLANS.c.revision == RECORDINGS.c.revision,
        PLANS.c.pipeline_version == version,
        PLANS.c.state.in_((WorkState.DONE, WorkState.REFUSED)),
    )
    unfinished = exists().where(
        SHARDS.c.log_id == RECORDINGS.c.log_id,
        SHARDS.c.revision == RECORDINGS.c.revision,
        SHARDS.c.pipeline_version == version,
        SHARDS.c.state != WorkState.DONE,
    )
    return exists(select(RECORDINGS.c.log_id).where(its, or_(~planned, unfinished)))
