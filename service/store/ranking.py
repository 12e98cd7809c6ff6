"""Ranking of current scenes, read lazily in its order."""

import json
from collections.abc import Generator
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, bindparam, literal_column, select

from service.curation.ranking import RankedInput, RankedScene, twin_of
from service.store.record_digests import OnDamaged, problem_of
from service.store.statements import Statement
from service.store.tables import SCENES

_AT_ONCE: Final = 500
"""Rows in memory at a time, however many are ranked."""


def ranked(
    connection: Connection, *, most: int | None = None, on_damaged: OnDamaged
) -> Generator[RankedScene, None, None]:
    """Rank current scenes, best first, ranks from 1; each is compared with its record.

    Args:
        connection: In the transaction to read from; it is read while this is iterated.
        most: Number of rows; None: all.
        on_damaged: Called for damaged scenes, which are left out.
    """
    query = (
        select(*_READ, _C.lidar_topic, _C.reasons, _C.sha256, _C.record)
        .where(_C.is_current)
        .order_by(_UNJUDGED, _C.score.desc(), _bytewise(connection), _C.start_ns, _C.scene_id)
        .limit(most)
    )
    with connection.execute(query, execution_options={"yield_per": _AT_ONCE}) as rows:
        rank = 0
        for row in rows:
            if problem := problem_of(row):
                on_damaged(row.scene_id, problem)
                continue
            rank += 1
            yield RankedScene(
                rank=rank,
                scene_id=row.scene_id,
                log_id=row.log_id,
                start_ns=row.start_ns,
                end_ns=row.end_ns,
                score=row.score,
                reasons=headlines_of(row.reasons),
                twin_of=_twin_of(connection, row),
                sha256=row.sha256,
            )


def _twin_of(connection: Connection, row: Any) -> str | None:
    here = {"log": row.log_id, "topic": row.lidar_topic, "start": row.start_ns}
    return twin_of(
        _input(row),
        before=_input_or_none(_BEFORE.first(connection, here)),
        after=_input_or_none(_AFTER.first(connection, here)),
    )


def _input_or_none(row: Any) -> RankedInput | None:
    return None if row is None else _input(row)


def _input(row: Any) -> RankedInput:
    return RankedInput(
        scene_id=row.scene_id,
        log_id=row.log_id,
        start_ns=row.start_ns,
        end_ns=row.end_ns,
        score=row.score,
        state=row.state,
    )


def _bytewise(connection: Connection) -> ColumnElement[str]:
    """Return log ids in Python's order of text, for which PostgreSQL needs a collation."""
    return _C.log_id if connection.dialect.name == "sqlite" else _C.log_id.collate("C")


_C: Final = SCENES.c
_READ: Final = (_C.scene_id, _C.log_id, _C.start_ns, _C.end_ns, _C.score, _C.state)

_UNJUDGED: Final[ColumnElement[bool]] = literal_column("(state <> 'scored')")
"""Condition in the spelling of the index, which is not used otherwise."""

_OF_LIDAR: Final = select(*_READ).where(
    _C.is_current, _C.log_id == bindparam("log"), _C.lidar_topic == bindparam("topic")
)
_BEFORE: Final = Statement(
    _OF_LIDAR.where(_C.start_ns < bindparam("start")).order_by(_C.start_ns.desc()).limit(1)
)
_AFTER: Final = Statement(
    _OF_LIDAR.where(_C.start_ns > bindparam("start")).order_by(_C.start_ns).limit(1)
)


def headlines_of(reasons: str) -> tuple[str, ...]:
    """Return the headlines of stored reasons; those of version 1 are sentences, kept as such."""
    return tuple(
        each if isinstance(each, str) else each["headline"] for each in json.loads(reasons)
    )
