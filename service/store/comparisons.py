"""Scenes of the two versions of a comparison, current or of an earlier pipeline version."""

import json
from collections.abc import Iterator
from datetime import UTC, datetime
from itertools import takewhile
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, and_, exists, or_, select

from schemas.arrays import NS_PER_S
from schemas.contradiction import SceneState, TrackRecord
from schemas.score import MIN_REPORTED_STRENGTH, from_version_1
from service.curation.compared_scenes import ComparedScene, NamedSide
from service.curation.comparing import compare
from service.curation.comparison import ComparedSide, CompareRequest, Comparison
from service.curation.ranking import is_reason
from service.errors import NothingFoundError
from service.store.engine import Store
from service.store.ranking import place_in
from service.store.record_digests import OnDamaged, problem_of
from service.store.tables import PIPELINES, RECORDINGS, SCENES

MOST_NAMED: Final = 10
"""Known versions that a message names."""

_AT_ONCE: Final = 500
_C: Final = SCENES.c
_POINTS: Final = (
    _C.both_static,
    _C.both_dynamic,
    _C.only_semantic_dynamic,
    _C.only_predictive_dynamic,
)
_READ: Final = (
    *(_C.log_id, _C.scene_id, _C.seq, _C.is_current, _C.vehicle, _C.software_version),
    *(_C.start_ns, _C.end_ns, _C.score, _C.sha256, _C.record, *_POINTS),
)


class Comparisons:
    """Reads the two sides of a comparison; it stores nothing."""

    def __init__(self, store: Store) -> None:
        """Keep the store."""
        self._store = store

    def compare(self, request: CompareRequest) -> Comparison:
        """Compare two versions of this ledger.

        Raises:
            NothingFoundError: If there is no such version, or nothing to compare.
            UsageError: If a side has too few logs.
        """
        return compare(self.side(request.a), self.side(request.b), request.terms)

    def side(self, asked: ComparedSide, *, name: str = "") -> NamedSide:
        """Read the scored scenes of one side.

        Args:
            asked: The side.
            name: Name of the side in the result; by default its terms.

        Raises:
            NothingFoundError: If there is no such version.
        """
        with self._store.reading() as connection:
            which = _which(connection, asked)
            scenes = list(_scenes(connection, which, on_damaged=self._store.note_damaged))
            if not scenes and asked.software_version is not None:
                raise _no_such_software(connection, asked.software_version)
        return NamedSide(name or side_name(asked), scenes)


def side_name(asked: ComparedSide) -> str:
    """Return the terms of a side in a few words."""
    words = [
        f"{word} {value}"
        for word, value in (
            ("software", asked.software_version),
            ("pipeline", asked.pipeline_version),
            ("vehicle", asked.vehicle),
        )
        if value is not None
    ]
    if asked.since_ns:
        words.append(f"since {_minute(asked.since_ns)}")
    if asked.until_ns is not None:
        words.append(f"until {_minute(asked.until_ns)}")
    return ", ".join(words) or "all current scenes"


def _minute(stamp_ns: int) -> str:
    return f"{datetime.fromtimestamp(stamp_ns / NS_PER_S, tz=UTC):%Y-%m-%d %H:%M} UTC"


def _which(connection: Connection, asked: ComparedSide) -> ColumnElement[bool]:
    which = [_C.state == SceneState.SCORED.value]
    if asked.pipeline_version is None:
        which.append(_C.is_current)
    else:
        version = _pipeline_named(connection, asked.pipeline_version)
        recorded = exists().where(
            RECORDINGS.c.log_id == _C.log_id,
            RECORDINGS.c.revision == _C.revision,
            RECORDINGS.c.is_current,
        )
        kept = or_(_C.is_current, _C.withdrawn_by == "pipeline")
        which += [_C.pipeline_version == version, recorded, kept]
    if asked.software_version is not None:
        which.append(_C.software_version == asked.software_version)
    if asked.vehicle is not None:
        which.append(_C.vehicle == asked.vehicle)
    if asked.since_ns:
        which.append(_C.start_ns >= asked.since_ns)
    if asked.until_ns is not None:
        which.append(_C.start_ns < asked.until_ns)
    return and_(*which)


def _pipeline_named(connection: Connection, said: str) -> str:
    """Return the pipeline version of a name or of its first characters.

    Raises:
        NothingFoundError: If there is none, or several.
    """
    rows = connection.execute(select(PIPELINES).order_by(PIPELINES.c.ordinal.desc())).all()
    known = [str(row.pipeline_version) for row in rows]
    found = [each for each in known if each == said] or [
        each for each in known if each.startswith(said)
    ]
    if len(found) == 1:
        return found[0]
    what = "several pipeline versions begin with" if found else "no pipeline version"
    raise NothingFoundError(f"{what} {said!r}; newest first: {_named(known)}")


def _no_such_software(connection: Connection, said: str) -> NothingFoundError:
    query = select(_C.software_version).where(_C.is_current).distinct()
    known = sorted(str(each) for each in connection.execute(query).scalars())
    return NothingFoundError(
        f"no scored scene of software version {said!r} passes; known: {_named(known)}"
    )


def _named(known: list[str]) -> str:
    return ", ".join(known[:MOST_NAMED]) or "none"


def _scenes(
    connection: Connection, which: ColumnElement[bool], *, on_damaged: OnDamaged
) -> Iterator[ComparedScene]:
    query = select(*_READ).where(which).order_by(_C.log_id, _C.start_ns, _C.scene_id)
    with connection.execute(query, execution_options={"yield_per": _AT_ONCE}) as rows:
        for row in rows:
            if problem := problem_of(row):
                on_damaged(row.scene_id, problem)
                continue
            yield _scene(row)


def _scene(row: Any) -> ComparedScene:
    record = json.loads(row.record)
    if record["schema_version"] == 1:
        record = from_version_1(record)
    seconds = max(1, row.end_ns - row.start_ns) / NS_PER_S
    compared = sum(getattr(row, column.name) for column in _POINTS)
    moving = row.both_dynamic + row.only_predictive_dynamic
    return ComparedScene(
        scene_id=row.scene_id,
        log_id=row.log_id,
        start_ns=row.start_ns,
        end_ns=row.end_ns,
        vehicle=row.vehicle,
        software_version=row.software_version,
        seq=row.seq if row.is_current and row.seq else 0,
        score=row.score,
        speed_m_per_s=record["odometry"]["distance_m"] / seconds,
        moving_share=moving / compared if compared else 0.0,
        tracks=_reasons(record["tracks"]),
        place=place_in(record),
        labelled_share=(record.get("supervised") or {}).get("labelled_share", 1.0),
    )


def _reasons(tracks: list[Any]) -> tuple[TrackRecord, ...]:
    """Return the strong tracks on which the supervised stream errs, strongest first."""
    strong = takewhile(lambda each: each["strength"] >= MIN_REPORTED_STRENGTH, tracks)
    found = (TrackRecord.model_validate(each) for each in strong)
    return tuple(
        each
        for each in found
        if is_reason(each.strength, each.attribution.wrong if each.attribution else None)
    )
