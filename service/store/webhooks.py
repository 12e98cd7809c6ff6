"""Events for webhooks in the store, in the order of their numbers, and how far each receiver is."""

from collections.abc import Callable, Mapping, Sequence
from typing import Final, Literal, get_args

from sqlalchemy import Connection, and_, func, insert, select, update

from schemas.canonical import canonical_json
from service.curation.webhooks import Due, WebhookEvent, gate_event, mode_event
from service.curation.webhooks import scene_event as made_of_scene
from service.curation.webhooks import selection_event as made_of_selection
from service.store.engine import Store
from service.store.tables import (
    COUNTERS,
    NOTICES,
    SCENES,
    SELECTION_SCENES,
    SELECTIONS,
    WEBHOOK_CURSORS,
)

Source = Literal["scenes", "selections", "notices"]
"""Numbered sources of events: scenes by `seq`, selections by ordinal, notices by theirs."""

SOURCES: Final = get_args(Source)

PAGE: Final = 256
"""Events read at a time; bounds memory."""

NoticeKind = Literal["mode", "known mode", "gate"]
"""Kind of a notice; a known mode was there before modes were watched, and is no event."""

_MADE: Final = {"mode": mode_event, "gate": gate_event}


class Webhooks:
    """Cursors of receivers, and the events after them."""

    def __init__(self, store: Store, *, now_s: Callable[[], float]) -> None:
        """Keep the store and the clock for what is durable, seconds."""
        self._store, self._now_s = store, now_s

    def begin(self, receiver: str) -> None:
        """Begin a receiver at the present numbers, unless it has begun before."""
        with self._store.writing() as connection:
            known = set(_cursors(connection, receiver))
            rows = [
                {"receiver": receiver, "source": source, "value": _last(connection, source)}
                for source in SOURCES
                if source not in known
            ]
            if rows:
                connection.execute(insert(WEBHOOK_CURSORS), rows)

    def cursors(self, receiver: str) -> Mapping[str, int]:
        """Return how far a receiver has each source."""
        with self._store.reading() as connection:
            return _cursors(connection, receiver)

    def delivered(self, receiver: str, source: Source, number: int) -> None:
        """Move a cursor forward, never back."""
        with self._store.writing() as connection:
            connection.execute(
                update(WEBHOOK_CURSORS)
                .where(
                    WEBHOOK_CURSORS.c.receiver == receiver,
                    WEBHOOK_CURSORS.c.source == source,
                    WEBHOOK_CURSORS.c.value < number,
                )
                .values(value=number)
            )

    def after(self, source: Source, number: int, *, min_score: float) -> Sequence[Due]:
        """Return the next events of a source, at most PAGE, with gaps where there is none to send.

        Args:
            source: One of SOURCES.
            number: Number after which they begin.
            min_score: Scenes below it are no events.
        """
        with self._store.reading() as connection:
            if source == "scenes":
                return _scenes(connection, number, min_score)
            if source == "selections":
                return _selections(connection, number)
            return _notices(connection, number)

    def note(self, kind: NoticeKind, named: Mapping[str, Mapping[str, object]]) -> int:
        """Store notices that are not there yet; return how many are new.

        A mode that is known is not noted again as a new one.

        Args:
            kind: Kind of the notices.
            named: Body of each by its name.
        """
        with self._store.writing() as connection:
            known = set(connection.execute(select(NOTICES.c.name)).scalars())
            last = _last(connection, "notices")
            rows = [
                {
                    "ordinal": last + 1 + at,
                    "kind": kind,
                    "name": name,
                    "body": canonical_json(dict(named[name])).decode(),
                    "noted_s": self._now_s(),
                }
                for at, name in enumerate(sorted(set(named) - known))
            ]
            if rows:
                connection.execute(insert(NOTICES), rows)
            return len(rows)

    def has_noted(self, kind: NoticeKind) -> bool:
        """Return true if there is a notice of a kind."""
        query = select(NOTICES.c.ordinal).where(NOTICES.c.kind == kind).limit(1)
        with self._store.reading() as connection:
            return connection.execute(query).first() is not None


def _cursors(connection: Connection, receiver: str) -> dict[str, int]:
    query = select(WEBHOOK_CURSORS.c.source, WEBHOOK_CURSORS.c.value).where(
        WEBHOOK_CURSORS.c.receiver == receiver
    )
    return {row.source: int(row.value) for row in connection.execute(query)}


def _last(connection: Connection, source: str) -> int:
    """Return the last number of a source."""
    if source == "notices":
        query = select(func.coalesce(func.max(NOTICES.c.ordinal), 0))
    else:
        counter = {"scenes": "seq", "selections": "selection"}[source]
        query = select(COUNTERS.c.value).where(COUNTERS.c.name == counter)
    return int(connection.execute(query).scalar_one())


def _scenes(connection: Connection, number: int, min_score: float) -> list[Due]:
    """Return scenes whose score is new: no earlier record of the scene has reached it."""
    wanted = (
        SCENES.c.seq,
        SCENES.c.scene_id,
        SCENES.c.log_id,
        SCENES.c.vehicle,
        SCENES.c.software_version,
        SCENES.c.start_ns,
        SCENES.c.end_ns,
        SCENES.c.score,
        SCENES.c.reasons,
        SCENES.c.sha256,
    )
    query = (
        select(*wanted)
        .where(SCENES.c.is_current, SCENES.c.seq > number)
        .order_by(SCENES.c.seq)
        .limit(PAGE)
    )
    return [
        Due(
            int(row.seq),
            made_of_scene(row)
            if row.score >= min_score and not _was_reached(connection, row, min_score)
            else None,
        )
        for row in connection.execute(query).all()
    ]


def _was_reached(connection: Connection, row: object, min_score: float) -> bool:
    log_id, scene_id, seq = (getattr(row, name) for name in ("log_id", "scene_id", "seq"))
    query = (
        select(SCENES.c.seq)
        .where(
            and_(SCENES.c.log_id == log_id, SCENES.c.scene_id == scene_id),
            SCENES.c.score >= min_score,
            SCENES.c.seq < seq,
        )
        .limit(1)
    )
    return connection.execute(query).first() is not None


def _selections(connection: Connection, number: int) -> list[Due]:
    scenes = (
        select(func.count())
        .where(SELECTION_SCENES.c.name == SELECTIONS.c.name)
        .scalar_subquery()
        .label("scenes")
    )
    query = (
        select(SELECTIONS, scenes)
        .where(SELECTIONS.c.ordinal > number)
        .order_by(SELECTIONS.c.ordinal)
        .limit(PAGE)
    )
    return [Due(int(row.ordinal), made_of_selection(row)) for row in connection.execute(query)]


def _notices(connection: Connection, number: int) -> list[Due]:
    query = (
        select(NOTICES).where(NOTICES.c.ordinal > number).order_by(NOTICES.c.ordinal).limit(PAGE)
    )
    found: list[Due] = []
    for row in connection.execute(query):
        made = _MADE.get(row.kind)
        event: WebhookEvent | None = made(row.body, row.noted_s) if made else None
        found.append(Due(int(row.ordinal), event))
    return found
