"""Ranking of current scenes, read lazily in its order."""

import json
from collections.abc import Container, Generator, Mapping
from itertools import takewhile
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, bindparam, literal_column, select

from schemas.contradiction import TrackRecord
from schemas.events import MAX_LISTED_TRACKS, TrackSummary
from schemas.score import MIN_REPORTED_STRENGTH, from_version_1
from schemas.surroundings import CloudStatistics, ScenePlace
from service.curation.candidates import Candidate
from service.curation.ranking import Neighbour, RankedScene
from service.curation.twins import ShownScene, Twins
from service.store.record_digests import OnDamaged, problem_of
from service.store.statements import Statement
from service.store.tables import SCENES

_AT_ONCE: Final = 500
"""Rows in memory at a time, however many are ranked."""


def ranked(
    connection: Connection, *, most: int | None = None, on_damaged: OnDamaged
) -> Generator[RankedScene, None, None]:
    """Rank current scenes, as `candidates` does, with their places."""
    for each in candidates(connection, most=most, on_damaged=on_damaged):
        placed = each.place is not None
        yield each.scene.model_copy(update={"place": each.place}) if placed else each.scene


def candidates(
    connection: Connection,
    *,
    most: int | None = None,
    only: Container[int] | None = None,
    on_damaged: OnDamaged,
) -> Generator[Candidate, None, None]:
    """Rank current scenes, best first, ranks from 1; each is compared with its record.

    Args:
        connection: In the transaction to read from; it is read while this is iterated.
        most: Number of rows; None: all.
        only: Numbers of the scenes that are returned; None: all. The others keep their ranks, and
            have twins.
        on_damaged: Called for damaged scenes, which are left out.
    """
    query = (
        select(*_READ, *_ODOM, _C.log_id, _C.lidar_topic, _C.score, _C.state, _C.reasons)
        .add_columns(_C.sha256, _C.record, _C.vehicle, _C.software_version, _C.seq)
        .where(_C.is_current)
        .order_by(_UNJUDGED, _C.score.desc(), _bytewise(connection), _C.start_ns, _C.scene_id)
        .limit(most)
    )
    twins = Twins()
    with connection.execute(query, execution_options={"yield_per": _AT_ONCE}) as rows:
        rank = 0
        for row in rows:
            if problem := problem_of(row):
                on_damaged(row.scene_id, problem)
                continue
            rank += 1
            record = _record_of(row)
            shown = _shown(row, record)
            twin_of = twins.twin_of(shown, _around(connection, row)) if shown.tracks else None
            if only is not None and row.seq not in only:
                continue
            scene = RankedScene(
                rank=rank,
                scene_id=row.scene_id,
                log_id=row.log_id,
                start_ns=row.start_ns,
                end_ns=row.end_ns,
                score=row.score,
                reasons=headlines_of(row.reasons),
                tracks=tuple(TrackSummary.of(each) for each in shown.tracks[:MAX_LISTED_TRACKS]),
                twin_of=twin_of,
                sha256=row.sha256,
            )
            yield Candidate(
                *(scene, row.vehicle, row.software_version, row.seq),
                cloud=cloud_in(record),
                place=shown.place,
            )


def cloud_in(record: Mapping[str, Any]) -> CloudStatistics | None:
    """Read the statistics of the clouds in a record; None where it has none."""
    found = record.get("cloud")
    return None if found is None else CloudStatistics.model_validate(found)


def place_in(record: Mapping[str, Any]) -> ScenePlace | None:
    """Read where a scene was recorded; None where its record does not state it."""
    found = record.get("place")
    return None if found is None else ScenePlace.model_validate(found)


def _record_of(row: Any) -> Mapping[str, Any]:
    """Decode a record; that of a scene that no track can make worth a review is not decoded."""
    if row.score < MIN_REPORTED_STRENGTH:
        return {}
    record: Mapping[str, Any] = json.loads(row.record)
    return from_version_1(record) if record["schema_version"] == 1 else record


def _shown(row: Any, record: Mapping[str, Any]) -> ShownScene:
    """Read the strong tracks of a scene; a scene scores at least as much as its strongest one."""
    at = Neighbour(row.scene_id, row.start_ns, row.end_ns)
    odom = tuple(getattr(row, each.name) for each in (_C.log_id, _C.lidar_topic, *_ODOM))
    if not record:
        return ShownScene(at, odom, 0.0, ())
    tracks = takewhile(lambda each: each["strength"] >= MIN_REPORTED_STRENGTH, record["tracks"])
    return ShownScene(
        at,
        odom,
        driven_m=record["odometry"]["distance_m"],
        tracks=tuple(TrackRecord.model_validate(each) for each in tracks),
        place=place_in(record),
    )


def _around(connection: Connection, row: Any) -> tuple[Neighbour | None, Neighbour | None]:
    """Read the scenes of the same log and lidar right before and after a scene."""
    here = {"log": row.log_id, "topic": row.lidar_topic, "start": row.start_ns}
    before, after = (each.first(connection, here) for each in (_BEFORE, _AFTER))
    return before and Neighbour(*before), after and Neighbour(*after)


def _bytewise(connection: Connection) -> ColumnElement[str]:
    """Return log ids in Python's order of text, for which PostgreSQL needs a collation."""
    return _C.log_id if connection.dialect.name == "sqlite" else _C.log_id.collate("C")


_C: Final = SCENES.c
_READ: Final = (_C.scene_id, _C.start_ns, _C.end_ns)
_ODOM: Final = (_C.revision, _C.pipeline_version, _C.shard)
"""Columns that identify the odom space of a scene, with its log and lidar."""

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
