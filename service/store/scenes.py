"""Queries of scenes for the outbox, the history, and single requests.

Each record is compared with its digest before it is returned; a damaged one is left out, and
reported.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, LargeBinary, Row, Select, and_, literal, select

from schemas.score import SceneScore
from schemas.transport.wire import decode
from service.errors import NothingFoundError, RecordDamagedError
from service.store.events import counter
from service.store.record_digests import OnDamaged, problem_of
from service.store.retirement import SceneOverlay, is_deleted
from service.store.same_bytes import refuse_copy
from service.store.tables import RECORDINGS, SCENES

_LAST: Final = 2**63 - 1


@dataclass(frozen=True, slots=True)
class StoredScene:
    """A durable, numbered scene.

    Attributes:
        seq: Number of the event, which rises by one over the whole store; sent in the attachment.
        log_id: Its recording.
        scene_id: `<log_id>/<lidar>/<start_ns>`.
        pipeline_version: Pipeline version that mined it.
        score: Score in the record.
        record: Bytes as published; empty when withdrawn.
        sha256: Digest of the record as published.
        withdrawn: True for the event of a withdrawal: the key is deleted instead of putting the
            record.
        overlay_deleted: True if the service has deleted its overlay.
    """

    seq: int
    log_id: str
    scene_id: str
    pipeline_version: str
    score: float
    record: bytes
    sha256: str
    withdrawn: bool = False
    overlay_deleted: bool = False

    def decoded(self) -> SceneScore:
        """Decode the record."""
        return decode(SceneScore, self.record)


def unpublished(connection: Connection, *, limit: int, on_damaged: OnDamaged) -> list[StoredScene]:
    """Read the events after the outbox's cursor, in order: scenes stored, scenes withdrawn."""
    return _sound_events(
        lambda after: _events(connection, SCENES.c.seq > after, after=after, limit=limit),
        after=counter(connection, "published"),
        limit=limit,
        on_damaged=on_damaged,
    )


def events_since(
    connection: Connection, *, after: int, limit: int, on_damaged: OnDamaged
) -> list[StoredScene]:
    """Read, in order, the events that lead from the scenes current then to those current now.

    Those are the current scenes with a greater number, and every withdrawal with one. A scene that
    was added and withdrawn has its withdrawal only. It is not known here if the client has seen the
    scene, since one that returns, or is replaced under its key, gets a new number.

    Args:
        connection: To read from.
        after: Only greater numbers.
        limit: Number of events at most, the first ones.
        on_damaged: Called for damaged scenes, which are left out.
    """
    return _sound_events(
        lambda after: _events(
            connection, and_(SCENES.c.is_current, SCENES.c.seq > after), after=after, limit=limit
        ),
        after=after,
        limit=limit,
        on_damaged=on_damaged,
    )


def _events(
    connection: Connection, puts: ColumnElement[bool], *, after: int, limit: int
) -> list[Row[Any]]:
    # Both walk the index of their number, and stop at the limit.
    came = connection.execute(_stored().where(puts).order_by(SCENES.c.seq).limit(limit)).all()
    until = came[-1].number if len(came) == limit else _LAST
    went = connection.execute(
        _stored(SCENES.c.withdrawn_seq, record=literal(b"", LargeBinary))
        .where(SCENES.c.withdrawn_seq > after, SCENES.c.withdrawn_seq < until)
        .order_by(SCENES.c.withdrawn_seq)
        .limit(limit)
    ).all()
    return sorted((*came, *went), key=lambda row: row.number)[:limit]


def _sound_events(
    read: Callable[[int], list[Row[Any]]], *, after: int, limit: int | None, on_damaged: OnDamaged
) -> list[StoredScene]:
    """Read on while all scenes of a page are damaged, since an empty list means the end."""
    while True:
        rows = read(after)
        events = [_scene(row) for row in rows if _is_sound(row, on_damaged)]
        if events or limit is None or len(rows) < limit:
            return events
        after = rows[-1].number


def current_scenes(
    connection: Connection,
    *,
    after: int = 0,
    limit: int | None = None,
    newest: bool = False,
    on_damaged: OnDamaged,
) -> list[StoredScene]:
    """Read current scenes in the order of their numbers.

    Args:
        connection: To read from.
        after: Only greater numbers.
        limit: Number of scenes at most: the first ones, or the last ones with `newest`.
        newest: True to keep the last ones.
        on_damaged: Called for damaged scenes, which are left out.
    """
    order = SCENES.c.seq.desc() if newest else SCENES.c.seq
    query = _stored().where(SCENES.c.is_current).order_by(order).limit(limit)
    scenes = _sound_events(
        lambda after: list(connection.execute(query.where(SCENES.c.seq > after)).all()),
        after=after,
        limit=None if newest else limit,
        on_damaged=on_damaged,
    )
    return scenes[::-1] if newest else scenes


def current_scene(
    connection: Connection, scene_id: str, *, on_damaged: OnDamaged
) -> StoredScene | None:
    """Read one current scene.

    Raises:
        RecordDamagedError: If its record is damaged.
        NothingFoundError: If it was withdrawn, or another log with the same bytes is mined in place
            of its own.
    """
    found = _current(connection, scene_id, on_damaged=on_damaged)
    if found is None and (why := _why_withdrawn(connection, scene_id)):
        raise NothingFoundError(f"no current scene {scene_id!r}: {why}")
    return found


def _why_withdrawn(connection: Connection, scene_id: str) -> str:
    """Return when and why a scene was withdrawn; empty: it was never current."""
    log_id = scene_id.rsplit("/", 2)[0]
    rows = connection.execute(
        select(SCENES.c.withdrawn_seq, SCENES.c.withdrawn_by).where(
            SCENES.c.log_id == log_id,  # the index begins with it
            SCENES.c.scene_id == scene_id,
            SCENES.c.withdrawn_seq.is_not(None),
        )
    ).all()
    if not rows:
        return ""
    row = max(rows, key=lambda row: row.withdrawn_seq)
    withdrawn = f"it was withdrawn with event {row.withdrawn_seq}, when its log was"
    if row.withdrawn_by == "pipeline":
        return f"{withdrawn} mined again, which did not make this scene"
    there = select(RECORDINGS.c.revision).where(
        RECORDINGS.c.log_id == log_id, RECORDINGS.c.is_current
    )
    if connection.execute(there).first() is None:
        return f"{withdrawn} deleted from the bucket; it returns with the same log"
    return f"{withdrawn} replaced in the bucket"


def _current(connection: Connection, scene_id: str, *, on_damaged: OnDamaged) -> StoredScene | None:
    row = connection.execute(
        _stored().where(SCENES.c.is_current, SCENES.c.scene_id == scene_id)
    ).one_or_none()
    if row is None:
        refuse_copy(connection, scene_id)
        return None
    if problem := problem_of(row):
        on_damaged(scene_id, problem)
        raise RecordDamagedError(
            f"the stored record of {scene_id} is damaged: {problem}; it is not shown, restore the "
            "database from a copy, or mine its log again into another --state"
        )
    return _with_overlay(connection, _scene(row))


def _with_overlay(connection: Connection, scene: StoredScene) -> StoredScene:
    """Note whether the overlay of a scene was deleted."""
    overlay = SceneOverlay(scene.log_id, scene.scene_id, scene.pipeline_version, scene.sha256)
    return replace(scene, overlay_deleted=is_deleted(connection, overlay))


def last_scene(
    connection: Connection, scene_id: str, *, on_damaged: OnDamaged
) -> StoredScene | None:
    """Read a scene: the current one, else its last record; None where that one is damaged.

    Raises:
        RecordDamagedError: If the record of the current one is damaged.
    """
    if found := _current(connection, scene_id, on_damaged=on_damaged):
        return found
    row = connection.execute(
        _stored()
        .where(
            SCENES.c.log_id == scene_id.rsplit("/", 2)[0],  # the index begins with it
            SCENES.c.scene_id == scene_id,
            SCENES.c.is_current.is_(False),
        )
        .order_by(SCENES.c.withdrawn_seq.desc())
        .limit(1)
    ).one_or_none()
    if row is None or not _is_sound(row, on_damaged):
        return None
    return _with_overlay(connection, _scene(row))


def _is_sound(row: Row[Any], on_damaged: OnDamaged) -> bool:
    if row.withdrawn:  # has no record to compare
        return True
    problem = problem_of(row)
    if problem:
        on_damaged(row.scene_id, problem)
    return not problem


def _stored(
    seq: ColumnElement[int] = SCENES.c.seq, *, record: ColumnElement[bytes] | None = None
) -> Select[Any]:
    """Select scenes in their published form; with another record, in their withdrawn form."""
    c = SCENES.c
    return select(
        seq.label("number"),
        c.log_id,
        c.scene_id,
        c.pipeline_version,
        c.score,
        (c.record if record is None else record).label("record"),
        c.sha256,
        literal(record is not None).label("withdrawn"),
    )


def _scene(row: Row[Any]) -> StoredScene:
    return StoredScene(
        seq=row.number,
        log_id=row.log_id,
        scene_id=row.scene_id,
        pipeline_version=row.pipeline_version,
        score=row.score,
        record=bytes(row.record),
        sha256=row.sha256,
        withdrawn=bool(row.withdrawn),
    )
