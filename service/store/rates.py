"""Sums over the current scenes of each vehicle, software version, hour, log or data set."""

from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, case, func, literal, select

from schemas.contradiction import SceneState
from service.curation.rates import HOUR_NS, RatesBy, RatesRequest, RateSums
from service.store.tables import SCENES


def rate_sums(connection: Connection, request: RatesRequest) -> list[RateSums]:
    """Sum over each group of the current scenes that were recorded in the requested time."""
    group = _GROUPS[request.by]
    query = select(group.label("grouped"), *_SUMS).where(SCENES.c.is_current)
    if request.since_ns:  # a condition that always holds would lead the database to its index
        query = query.where(SCENES.c.start_ns >= request.since_ns)
    if request.until_ns is not None:
        query = query.where(SCENES.c.start_ns < request.until_ns)
    # By kind all is one group; of nothing, that is a row of sums all the same.
    query = query.having(func.count() > 0) if request.by == "kind" else query.group_by(group)
    return [_sums(row._mapping) for row in connection.execute(query)]


def _sums(row: Any) -> RateSums:
    # PostgreSQL sums integers to decimals.
    whole = {name: int(row[name]) for name in _WHOLE}
    return RateSums(
        group=row["grouped"],
        score_sum=float(row["score_sum"]),
        best_score=float(row["best_score"]),
        **whole,
    )


def _count_if(condition: ColumnElement[bool]) -> ColumnElement[int]:
    return func.sum(case((condition, 1), else_=0))


_C: Final = SCENES.c

_GROUPS: Final[dict[RatesBy, ColumnElement[Any]]] = {
    "vehicle": _C.vehicle,
    "version": _C.software_version,
    "kind": literal("all"),
    "hour": _C.start_ns // HOUR_NS,
    "log": _C.log_id,
    "dataset": _C.log_id,  # added up by `service.curation.rates`
}

_WHOLE: Final[dict[str, ColumnElement[Any]]] = {
    "scenes": func.count(),
    "frames": func.sum(_C.frames),
    "compared": func.sum(
        _C.both_static + _C.both_dynamic + _C.only_semantic_dynamic + _C.only_predictive_dynamic
    ),
    "both_dynamic": func.sum(_C.both_dynamic),
    "only_semantic": func.sum(_C.only_semantic_dynamic),
    "only_predictive": func.sum(_C.only_predictive_dynamic),
    "contradicting_scenes": _count_if(_C.score > 0),
    "semantic_scenes": _count_if(_C.only_semantic_dynamic > 0),
    "predictive_scenes": _count_if(_C.only_predictive_dynamic > 0),
    "gated_scenes": _count_if(_C.state != SceneState.SCORED.value),
}

_SUMS: Final = (
    *(column.label(name) for name, column in _WHOLE.items()),
    func.sum(case((_C.state == SceneState.SCORED.value, _C.score), else_=0.0)).label("score_sum"),
    func.max(_C.score).label("best_score"),
)
