"""Verdicts in the store: numbered events, each written once; an undo is an event as well."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from sqlalchemy import ColumnElement, Connection, and_, func, insert, select, update

from schemas.score import SceneScore
from schemas.transport.wire import decode
from schemas.verdict import (
    Verdict,
    VerdictRecord,
    VerdictRow,
    VerdictSummary,
)
from service.curation.ranking import RankedScene
from service.curation.rates import JudgedScene
from service.curation.selection import Selection
from service.curation.verdicts import (
    AgreementReply,
    AgreementRequest,
    JudgeRequest,
    UndoRequest,
    VerdictsRequest,
    agreement,
    standing_of,
)
from service.errors import NothingFoundError, RecordDamagedError, UsageError
from service.store import audit
from service.store.engine import Store
from service.store.listed_scenes import judge_again, kinds_of
from service.store.record_digests import problem_of
from service.store.same_bytes import copies
from service.store.selections import scene_ids_of
from service.store.tables import COUNTERS, SCENES, VERDICTS
from service.store.transaction_effects import effects_of
from service.store.verdict_rows import (
    ROWS,
    current_verdicts,
    events_after,
    judged_scenes,
    rows_of,
    summaries,
)


class Verdicts:
    """Stored verdicts. An event never changes; which of them counts is noted next to it."""

    def __init__(self, store: Store, *, now_s: Callable[[], float]) -> None:
        """Keep the store and the clock for what is durable, seconds."""
        self._store, self._now_s = store, now_s

    def judge(self, request: JudgeRequest) -> VerdictRow:
        """Store a verdict; it replaces the reviewer's earlier one on the same scene or track.

        Raises:
            NothingFoundError: If there was never such a scene, record or track.
            UsageError: If the key is that of another write, or the request contradicts itself.
        """
        now_s, who = self._now_s(), audit.actor()

        def judged(connection: Connection) -> VerdictRow:
            is_new = _of_key(connection, request.key) is None
            row = _judge(connection, request, now_s)
            if is_new:
                _audit(connection, who, "judge", row, now_s=now_s)
            return row

        return self._store.write(judged)

    def undo(self, request: UndoRequest) -> VerdictRow:
        """Undo the reviewer's last verdict; the one before it on the same item counts again.

        Raises:
            NothingFoundError: If there is no verdict to undo.
            UsageError: If the key is that of another write.
        """
        now_s, who = self._now_s(), audit.actor()

        def undone(connection: Connection) -> VerdictRow:
            is_new = _of_key(connection, request.key) is None
            row = _undo(connection, request, now_s)
            if is_new:
                _audit(connection, who, "undo", row, now_s=now_s)
            return row

        return self._store.write(undone)

    def page(self, request: VerdictsRequest) -> list[VerdictRow]:
        """Return verdicts, latest first, one more than requested where there are more."""
        c = VERDICTS.c
        wanted: list[ColumnElement[bool]] = []
        if request.scene_id is not None:
            wanted.append(c.scene_id == request.scene_id)
        if request.reviewer is not None:
            wanted.append(c.reviewer == request.reviewer)
        if request.current:
            wanted.append(c.is_current)
        if request.before is not None:
            wanted.append(c.ordinal < request.before)
        query = ROWS.where(and_(True, *wanted)).order_by(c.ordinal.desc())
        with self._store.reading() as connection:
            return rows_of(connection, query.limit(request.most + 1))

    def current(self) -> list[VerdictRow]:
        """Return every verdict that counts, in the order of their numbers."""
        with self._store.reading() as connection:
            return current_verdicts(connection)

    def agreement(self, request: AgreementRequest) -> AgreementReply:
        """Return agreement, conflicts, pace and precision of the verdicts that count.

        Raises:
            NothingFoundError: If there is no such selection.
        """
        with self._store.reading() as connection:
            rows = current_verdicts(connection)
            if request.selection is None:
                return agreement(rows, budget=None)
            chosen = scene_ids_of(connection, request.selection)
            return agreement([row for row in rows if row.scene_id in chosen], budget=len(chosen))

    def summaries(
        self, scenes: Iterable[tuple[str, str]], *, reviewer: str | None = None
    ) -> dict[str, VerdictSummary]:
        """Count the verdicts on scenes, given as id and digest of the record that is shown.

        Returns:
            Counts by scene id, only of scenes that have a verdict.
        """
        with self._store.reading() as connection:
            return summaries(connection, scenes, reviewer=reviewer)

    def with_verdicts(self, rows: Sequence[RankedScene]) -> list[RankedScene]:
        """Return rows of the ranking with the verdicts on them, and other names of their logs."""
        found = self.summaries((row.scene_id, row.sha256) for row in rows)
        with self._store.reading() as connection:
            names = copies(connection)
        more = [
            ({"verdicts": found[row.scene_id]} if row.scene_id in found else {})
            | ({"same_logs": names[row.log_id]} if row.log_id in names else {})
            for row in rows
        ]
        return [
            row.model_copy(update=facts) if facts else row
            for row, facts in zip(rows, more, strict=True)
        ]

    def in_selection(self, selection: Selection) -> Selection:
        """Return a selection with the verdicts on its scenes."""
        rows = tuple(self.with_verdicts(selection.scenes))
        return selection.model_copy(update={"scenes": rows})

    def judged_scenes(self) -> list[JudgedScene]:
        """Return the current scenes with a verdict that decides, each once."""
        with self._store.reading() as connection:
            return judged_scenes(connection)

    def since(self, ordinal: int, limit: int) -> list[VerdictRecord]:
        """Return events with a greater number, in their order."""
        with self._store.reading() as connection:
            return events_after(connection, after=ordinal, limit=limit)

    def last(self) -> int:
        """Return the number of the last event, 0 when there is none."""
        with self._store.reading() as connection:
            return _counter(connection, "verdict")

    def unpublished(self, limit: int) -> list[VerdictRecord]:
        """Return events after the cursor of the outbox, in their order."""
        with self._store.reading() as connection:
            after = _counter(connection, "verdict_published")
            return events_after(connection, after=after, limit=limit)

    def mark_published(self, ordinal: int) -> None:
        """Move the cursor forward, durably: everything up to this number is published."""
        with self._store.writing() as connection:
            connection.execute(
                update(COUNTERS)
                .where(COUNTERS.c.name == "verdict_published", COUNTERS.c.value < ordinal)
                .values(value=ordinal)
            )


def _audit(
    connection: Connection, who: audit.Actor, what: str, row: VerdictRow, *, now_s: float
) -> None:
    detail = {"ordinal": row.ordinal, "scene_id": row.scene_id, "reviewer": row.reviewer}
    detail |= {"verdict": row.verdict.value, "cause": row.cause, "track_id": row.track_id}
    audit.record(connection, who, what, detail, now_s=now_s)


def _judge(connection: Connection, request: JudgeRequest, now_s: float) -> VerdictRow:
    if request.verdict is Verdict.WITHDRAWN:
        raise UsageError("a verdict is not given as withdrawn: undo it")
    if request.duplicate_of is not None and request.verdict is not Verdict.DUPLICATE:
        raise UsageError(f"duplicate_of is for verdict duplicate, not {request.verdict.value}")
    if request.duplicate_of == request.scene_id:
        raise UsageError("a scene is no duplicate of itself; name the other one")
    if (stored := _of_key(connection, request.key)) is not None:
        asked = request.model_dump(exclude={"key"} if request.sha256 else {"key", "sha256"})
        if any(getattr(stored, name) != value for name, value in asked.items()):
            raise _other_write(request.key)
        return stored
    seen = _seen(connection, request.scene_id, request.sha256)
    if problem := problem_of(seen):
        raise RecordDamagedError(
            f"the stored record of {request.scene_id} is damaged: {problem}; it is not shown, and "
            "cannot be judged"
        )
    score = decode(SceneScore, bytes(seen.record))
    if request.track_id is not None and request.track_id not in _tracks(score):
        raise NothingFoundError(
            f"scene {request.scene_id!r} has no track {request.track_id + 1}, as pictures number "
            f"them; its record lists {len(score.tracks)}"
        )
    if request.duplicate_of is not None:
        _seen(connection, request.duplicate_of, None)
    return _store(
        connection,
        VerdictRecord(
            **request.model_dump(exclude={"sha256"}),
            ordinal=_next(connection),
            sha256=seen.sha256,
            judged_s=now_s,
        ),
        vehicle=score.vehicle,
        software_version=score.software_version,
        kinds=kinds_of(score),
    )


def _tracks(score: SceneScore) -> set[int]:
    return {track.track_id for track in score.tracks}


def _undo(connection: Connection, request: UndoRequest, now_s: float) -> VerdictRow:
    stored = _of_key(connection, request.key)
    if stored is not None:
        at = (stored.scene_id, stored.track_id) if request.scene_id else (None, None)
        asked = (request.scene_id, request.track_id if request.scene_id else None)
        is_same = stored.verdict is Verdict.WITHDRAWN and stored.reviewer == request.reviewer
        if not is_same or at != asked:
            raise _other_write(request.key)
        return stored
    c = VERDICTS.c
    wanted = [c.is_current, c.reviewer == request.reviewer]
    if request.scene_id is not None:
        wanted += [c.scene_id == request.scene_id, _is_same(c.track_id, request.track_id)]
    last = connection.execute(
        select(VERDICTS).where(*wanted).order_by(c.ordinal.desc()).limit(1)
    ).one_or_none()
    if last is None:
        where = f" on {request.scene_id!r}" if request.scene_id else ""
        raise NothingFoundError(f"{request.reviewer!r} has no verdict{where} to undo")
    return _store(
        connection,
        VerdictRecord(
            ordinal=_next(connection),
            key=request.key,
            scene_id=last.scene_id,
            sha256=last.sha256,
            track_id=last.track_id,
            reviewer=last.reviewer,
            verdict=Verdict.WITHDRAWN,
            judged_s=now_s,
        ),
        vehicle=last.vehicle,
        software_version=last.software_version,
        kinds=last.kinds,
    )


def _store(connection: Connection, event: VerdictRecord, **copied: str) -> VerdictRow:
    """Store an event, and note which of the reviewer's verdicts on this item counts now."""
    c = VERDICTS.c
    connection.execute(
        insert(VERDICTS).values(
            event.model_dump() | {"verdict": event.verdict.value, "is_current": False} | copied
        )
    )
    item = and_(
        c.scene_id == event.scene_id,
        c.sha256 == event.sha256,
        c.reviewer == event.reviewer,
        _is_same(c.track_id, event.track_id),
    )
    events = connection.execute(select(c.ordinal, c.verdict).where(item).order_by(c.ordinal)).all()
    counts = standing_of((row.ordinal, Verdict(row.verdict)) for row in events)
    connection.execute(update(VERDICTS).where(item, c.is_current).values(is_current=False))
    if counts is not None:
        connection.execute(update(VERDICTS).where(c.ordinal == counts).values(is_current=True))
    judge_again(connection, event.scene_id, event.sha256)
    effects_of(connection).verdicts[event.verdict] += 1
    (row,) = rows_of(connection, ROWS.where(c.ordinal == event.ordinal))
    return row


def _seen(connection: Connection, scene_id: str, digest: str | None) -> Any:
    """Find the stored record of a scene: that of the digest, else the current or last one.

    Raises:
        NothingFoundError: If the scene never existed, or never had this record.
    """
    c = SCENES.c
    columns = (c.sha256, c.record)
    current = connection.execute(
        select(*columns).where(c.is_current, c.scene_id == scene_id)
    ).one_or_none()
    if current is not None and digest in (None, current.sha256):
        return current
    # The index of withdrawn scenes begins with the log, whose id is part of the scene's.
    withdrawn = (
        select(*columns)
        .where(~c.is_current, c.log_id == scene_id.rsplit("/", 2)[0], c.scene_id == scene_id)
        .order_by(func.coalesce(c.withdrawn_seq, c.seq, 0).desc())
        .limit(1)
    )
    if digest is not None:
        withdrawn = withdrawn.where(c.sha256 == digest)
    found = connection.execute(withdrawn).one_or_none()
    if found is None and digest is not None:
        _seen(connection, scene_id, None)  # the scene itself is missed first
        raise NothingFoundError(
            f"scene {scene_id!r} never had the record {digest}; open the scene again"
        )
    if found is None:
        raise NothingFoundError(
            f"there was never a scene {scene_id!r}; `counterpoint top` lists those of now"
        )
    return found


def _next(connection: Connection) -> int:
    return int(
        connection.execute(
            update(COUNTERS)
            .where(COUNTERS.c.name == "verdict")
            .values(value=COUNTERS.c.value + 1)
            .returning(COUNTERS.c.value)
        ).scalar_one()
    )


def _counter(connection: Connection, name: str) -> int:
    return int(
        connection.execute(select(COUNTERS.c.value).where(COUNTERS.c.name == name)).scalar_one()
    )


def _of_key(connection: Connection, key: str) -> VerdictRow | None:
    found = rows_of(connection, ROWS.where(VERDICTS.c.key == key))
    return found[0] if found else None


def _other_write(key: str) -> UsageError:
    return UsageError(f"the key {key!r} names another write; give each write a key of its own")


def _is_same(column: ColumnElement[Any], value: int | None) -> ColumnElement[bool]:
    return column.is_(None) if value is None else column == value
