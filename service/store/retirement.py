"""Queries on overlays that may be deleted: unneeded ones first, then those of low scenes."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
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
)

from service.store.overview import newest_pipeline
from service.store.tables import (
    PLANS,
    RECORDINGS,
    RETIRED_OVERLAYS,
    SCENES,
    SELECTION_SCENES,
    SHARDS,
    VERDICTS,
)
from service.store.work_items import Work, WorkState


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
    """Find recorded overlays whose scene has become current again.

    A deleted one is found only if its shard was mined after that, since it is there again then.
    """
    c = RETIRED_OVERLAYS.c
    mined_since = exists().where(
        _same_overlay(SCENES, RETIRED_OVERLAYS),
        SHARDS.c.log_id == SCENES.c.log_id,
        SHARDS.c.pipeline_version == SCENES.c.pipeline_version,
        SHARDS.c.name == SCENES.c.shard,
        SHARDS.c.committed_s > c.since_s,
    )
    query = select(*_of(RETIRED_OVERLAYS)).where(_is_current(RETIRED_OVERLAYS))
    return _portions(connection, query.where(or_(~c.is_deleted, mined_since)), portion)


def note_retired(connection: Connection, overlays: Sequence[SceneOverlay], *, now_s: float) -> None:
    """Record these overlays as unused from now on."""
    rows = [asdict(each) | {"since_s": now_s, "is_deleted": False} for each in overlays]
    connection.execute(insert(RETIRED_OVERLAYS), rows)


def forget(connection: Connection, overlays: Sequence[SceneOverlay]) -> None:
    """Remove these overlays from the record."""
    connection.execute(delete(RETIRED_OVERLAYS).where(_AT), _keys(overlays))


def to_delete(
    connection: Connection, *, before_s: float, limit: int, keep_pipelines: Sequence[str] = ()
) -> list[SceneOverlay]:
    """Find overlays that have been unused since a time, the oldest first.

    Those of selected and judged scenes are left out, and those of a log with pending work. A shard
    that is mined again may produce the same record as a withdrawn one, and its worker writes the
    overlay before it commits.
    """
    c = RETIRED_OVERLAYS.c
    found = connection.execute(
        select(*_of(RETIRED_OVERLAYS))
        .where(
            ~c.is_deleted,
            c.since_s <= before_s,
            ~_is_current(RETIRED_OVERLAYS),
            ~_is_worked_on(newest_pipeline(connection)),
            *(~c.pipeline_version.startswith(each, autoescape=True) for each in keep_pipelines),
        )
        .order_by(c.since_s, *_of(RETIRED_OVERLAYS))
    )
    protected = protected_scenes(connection)
    free = (each for row in found if not protected.has(each := SceneOverlay(*row)))
    return list(islice(free, limit))


def low_ranked(
    connection: Connection, *, limit: int, keep_pipelines: Sequence[str] = ()
) -> list[SceneOverlay]:
    """Find overlays of current scenes that are not selected or judged, the lowest score first."""
    c, protected = SCENES.c, protected_scenes(connection)
    retired = exists().where(_same_overlay(SCENES, RETIRED_OVERLAYS), RETIRED_OVERLAYS.c.is_deleted)
    found = connection.execute(
        select(*_of(SCENES))
        .where(
            c.is_current,
            ~retired,
            *(~c.pipeline_version.startswith(each, autoescape=True) for each in keep_pipelines),
        )
        .order_by(c.score, c.start_ns, c.scene_id),
        execution_options={"yield_per": 1000},
    )
    free = (each for row in found if not protected.has(each := SceneOverlay(*row)))
    return list(islice(free, limit))


@dataclass(frozen=True, slots=True)
class Protected:
    """Records of scenes that lose no overlay, by scene and digest."""

    records: frozenset[tuple[str, str]]

    def has(self, overlay: SceneOverlay) -> bool:
        """Return true for the overlay of such a record."""
        return (overlay.scene_id, overlay.sha256) in self.records


def protected_scenes(connection: Connection) -> Protected:
    """Return the records that are selected or judged."""
    selected = (
        json.loads(scene)
        for scene in connection.execute(select(SELECTION_SCENES.c.scene)).scalars()
    )
    judged = connection.execute(
        select(VERDICTS.c.scene_id, VERDICTS.c.sha256).where(VERDICTS.c.is_current)
    )
    records = {(scene["scene_id"], scene["sha256"]) for scene in selected}
    return Protected(frozenset(records | {(row.scene_id, row.sha256) for row in judged}))


def is_deleted(connection: Connection, overlay: SceneOverlay) -> bool:
    """Return true if the service has deleted an overlay."""
    found = connection.execute(
        select(RETIRED_OVERLAYS.c.is_deleted).where(_AT), _keys([overlay])[0]
    ).scalar_one_or_none()
    return bool(found)


def note_deleted(connection: Connection, overlays: Sequence[SceneOverlay], *, now_s: float) -> None:
    """Record the deletion of these overlays, noted before or not."""
    connection.execute(delete(RETIRED_OVERLAYS).where(_AT), _keys(overlays))
    rows = [asdict(each) | {"since_s": now_s, "is_deleted": True} for each in overlays]
    connection.execute(insert(RETIRED_OVERLAYS), rows)


def without_overlays(connection: Connection, log_ids: Sequence[str]) -> list[Work]:
    """Return the mined shards of these logs whose current scenes have lost their overlays."""
    found = connection.execute(
        select(SHARDS.c.log_id, SHARDS.c.revision, SHARDS.c.pipeline_version, SHARDS.c.name)
        .distinct()
        .join(
            RECORDINGS,
            and_(
                RECORDINGS.c.log_id == SHARDS.c.log_id,
                RECORDINGS.c.revision == SHARDS.c.revision,
                RECORDINGS.c.is_current,
            ),
        )
        .join(
            SCENES,
            and_(
                SCENES.c.log_id == SHARDS.c.log_id,
                SCENES.c.pipeline_version == SHARDS.c.pipeline_version,
                SCENES.c.shard == SHARDS.c.name,
                SCENES.c.is_current,
            ),
        )
        .join(RETIRED_OVERLAYS, and_(_same_overlay(SCENES, RETIRED_OVERLAYS)))
        .where(
            SHARDS.c.log_id.in_(log_ids),
            SHARDS.c.state == WorkState.DONE,
            SHARDS.c.pipeline_version == newest_pipeline(connection),
            RETIRED_OVERLAYS.c.is_deleted,
        )
        .order_by(SHARDS.c.log_id, SHARDS.c.name)
    )
    return [Work(*row) for row in found]


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
        PLANS.c.state.in_((WorkState.DONE, WorkState.REFUSED, WorkState.KEPT)),
    )
    unfinished = exists().where(
        SHARDS.c.log_id == RECORDINGS.c.log_id,
        SHARDS.c.revision == RECORDINGS.c.revision,
        SHARDS.c.pipeline_version == version,
        SHARDS.c.state != WorkState.DONE,
    )
    return exists(select(RECORDINGS.c.log_id).where(its, or_(~planned, unfinished)))
