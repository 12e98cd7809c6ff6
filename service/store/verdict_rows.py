"""Rows of the verdicts, with the state of the records they are on, and counts over them."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any, Final

from sqlalchemy import Connection, and_, case, func, select

from schemas.verdict import (
    DECIDED,
    RIGHT,
    Standing,
    Verdict,
    VerdictRecord,
    VerdictRow,
    VerdictSummary,
)
from service.curation.rates import JudgedScene
from service.store.listed_scenes import names_in
from service.store.tables import SCENES, VERDICTS

_DECIDED: Final = sorted(verdict.value for verdict in DECIDED)
_RIGHT: Final = sorted(verdict.value for verdict in RIGHT)

_IDS_AT_ONCE: Final = 5000
"""Scene ids in one statement; SQLite bounds its parameters to 32,766."""


def current_verdicts(connection: Connection) -> list[VerdictRow]:
    """Return every verdict that counts, in the order of their numbers."""
    return rows_of(connection, ROWS.where(VERDICTS.c.is_current).order_by(VERDICTS.c.ordinal))


def summaries(
    connection: Connection, scenes: Iterable[tuple[str, str]], *, reviewer: str | None
) -> dict[str, VerdictSummary]:
    """Count the verdicts on scenes, given as id and digest of the record that is shown."""
    shown = dict(scenes)
    c, found = VERDICTS.c, defaultdict[str, list[Any]](list)
    columns = (c.scene_id, c.sha256, c.track_id, c.reviewer, c.verdict, c.judged_s)
    query = select(*columns).where(c.is_current).order_by(c.ordinal)
    ids = list(shown)
    for begin in range(0, len(ids), _IDS_AT_ONCE):
        some = ids[begin : begin + _IDS_AT_ONCE]
        for row in connection.execute(query.where(c.scene_id.in_(some))):
            found[row.scene_id].append(row)
    return {
        scene_id: _summary(rows, digest=shown[scene_id], reviewer=reviewer)
        for scene_id, rows in found.items()
    }


def _summary(rows: Sequence[Any], *, digest: str, reviewer: str | None) -> VerdictSummary:
    counts: defaultdict[str, int] = defaultdict(int)
    mine, last_s = None, None
    for row in rows:
        if row.sha256 != digest:
            counts["earlier"] += 1
            continue
        counts["tracks" if row.track_id is not None else row.verdict] += 1
        last_s = row.judged_s
        if row.track_id is None and row.reviewer == reviewer:
            mine = Verdict(row.verdict)
    return VerdictSummary(mine=mine, last_s=last_s, **counts)


def judged_scenes(connection: Connection) -> list[JudgedScene]:
    """Return the current scenes with a verdict that decides, each once."""
    c, is_right = VERDICTS.c, func.max(case((VERDICTS.c.verdict.in_(_RIGHT), 1), else_=0))
    query = (
        select(
            SCENES.c.log_id,
            SCENES.c.start_ns,
            SCENES.c.vehicle,
            SCENES.c.software_version,
            c.kinds,
            is_right.label("is_right"),
        )
        .join(SCENES, and_(SCENES.c.scene_id == c.scene_id, SCENES.c.sha256 == c.sha256))
        .where(c.is_current, c.verdict.in_(_DECIDED), SCENES.c.is_current)
        .group_by(
            c.scene_id,
            SCENES.c.log_id,
            SCENES.c.start_ns,
            SCENES.c.vehicle,
            SCENES.c.software_version,
            c.kinds,
        )
    )
    return [
        JudgedScene(
            log_id=row.log_id,
            start_ns=row.start_ns,
            vehicle=row.vehicle,
            software_version=row.software_version,
            kinds=names_in(row.kinds),
            is_right=bool(row.is_right),
        )
        for row in connection.execute(query)
    ]


def events_after(connection: Connection, *, after: int, limit: int) -> list[VerdictRecord]:
    """Return events with a greater number, in their order."""
    names = tuple(VerdictRecord.model_fields)
    query = select(*(VERDICTS.c[name] for name in names)).where(VERDICTS.c.ordinal > after)
    rows = connection.execute(query.order_by(VERDICTS.c.ordinal).limit(limit))
    return [VerdictRecord(**row) for row in rows.mappings()]


def rows_of(connection: Connection, query: Any) -> list[VerdictRow]:
    """Read the rows of a query that `ROWS` begins."""
    return [
        VerdictRow(
            **{name: row[name] for name in (*VerdictRecord.model_fields, "is_current")},
            record=_standing(row),
        )
        for row in connection.execute(query).mappings()
    ]


def _standing(row: Any) -> Standing:
    if row["current_sha256"] is None:
        return "withdrawn"
    return "current" if row["current_sha256"] == row["sha256"] else "replaced"


ROWS: Final = select(VERDICTS, SCENES.c.sha256.label("current_sha256")).outerjoin(
    SCENES, and_(SCENES.c.is_current, SCENES.c.scene_id == VERDICTS.c.scene_id)
)
