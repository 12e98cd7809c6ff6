"""Scenes as readers get them: the outbox, the history, and one by one."""

from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, LargeBinary, Row, Select, and_, literal, select

from schemas.score import SceneScore
from schemas.wire import decode
from service.store.events import counter
from service.store.tables import SCENES

_LAST: Final = 2**63 - 1


@dataclass(frozen=True, slots=True)
class StoredScene:
    """A durable, numbered scene.

    Attributes:
        seq: Rises by one per event over the whole store; travels in the attachment.
        log_id: Its recording.
        scene_id: `<log_id>/<lidar>/<start_ns>`.
        pipeline_version: What mined it.
        score: As in the record.
        record: Bytes as published; empty when withdrawn.
        sha256: Digest of the record as published.
        withdrawn: Only among events: the one with this number says that the scene is no longer
            current: delete its key instead of putting the record.
    """

    seq: int
    log_id: str
    scene_id: str
    pipeline_version: str
    score: float
    record: bytes
    sha256: str
    withdrawn: bool = False

    def decoded(self) -> SceneScore:
        """Decode the record."""
        return decode(SceneScore, self.record)


def unpublished(connection: Connection, *, limit: int) -> list[StoredScene]:
    """Read the events after the outbox's cursor, in order: scenes stored, scenes withdrawn."""
    seq = counter(connection, "published")
    return _events(connection, SCENES.c.seq > seq, after=seq, limit=limit)


def events_since(connection: Connection, *, after: int, limit: int) -> list[StoredScene]:
    """Read, in order, what leads from the scenes that were current then to those that are now.

    Those are the current scenes with a greater number, and every withdrawal with one. A scene that
    came and went has its withdrawal only: whether an asker knows it cannot be told here, since a
    scene that returns, or is replaced under its key, gets a new number.

    Args:
        connection: To read from.
        after: Only greater numbers.
        limit: At most so many, the first ones.
    """
    return _events(
        connection, and_(SCENES.c.is_current, SCENES.c.seq > after), after=after, limit=limit
    )


def _events(
    connection: Connection, puts: ColumnElement[bool], *, after: int, limit: int
) -> list[StoredScene]:
    # Both walk the index of their number, and stop at the limit.
    came = connection.execute(_stored().where(puts).order_by(SCENES.c.seq).limit(limit)).all()
    until = came[-1].number if len(came) == limit else _LAST
    went = connection.execute(
        _stored(SCENES.c.withdrawn_seq, record=literal(b"", LargeBinary))
        .where(SCENES.c.withdrawn_seq > after, SCENES.c.withdrawn_seq < until)
        .order_by(SCENES.c.withdrawn_seq)
        .limit(limit)
    )
    events = [_scene(row) for row in came] + [_scene(row, withdrawn=True) for row in went]
    return sorted(events, key=lambda event: event.seq)[:limit]


def current_scenes(
    connection: Connection, *, after: int = 0, limit: int | None = None, newest: bool = False
) -> list[StoredScene]:
    """Read current scenes in the order of their numbers.

    Args:
        connection: To read from.
        after: Only greater numbers.
        limit: At most so many: the first ones, or the last ones with `newest`.
        newest: Which end `limit` keeps.
    """
    order = SCENES.c.seq.desc() if newest else SCENES.c.seq
    rows = connection.execute(
        _stored().where(SCENES.c.is_current, SCENES.c.seq > after).order_by(order).limit(limit)
    )
    scenes = [_scene(row) for row in rows]
    return scenes[::-1] if newest else scenes


def current_scene(connection: Connection, scene_id: str) -> StoredScene | None:
    """Read one current scene."""
    row = connection.execute(
        _stored().where(SCENES.c.is_current, SCENES.c.scene_id == scene_id)
    ).one_or_none()
    return None if row is None else _scene(row)


def _stored(
    seq: ColumnElement[int] = SCENES.c.seq, record: ColumnElement[bytes] = SCENES.c.record
) -> Select[Any]:
    c = SCENES.c
    return select(
        seq.label("number"),
        c.log_id,
        c.scene_id,
        c.pipeline_version,
        c.score,
        record.label("record"),
        c.sha256,
    )


def _scene(row: Row[Any], *, withdrawn: bool = False) -> StoredScene:
    return StoredScene(
        seq=row.number,
        log_id=row.log_id,
        scene_id=row.scene_id,
        pipeline_version=row.pipeline_version,
        score=row.score,
        record=bytes(row.record),
        sha256=row.sha256,
        withdrawn=withdrawn,
    )
