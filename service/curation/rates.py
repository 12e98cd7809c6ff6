"""Rate of contradictions, by vehicle, software version, kind, hour, log or data set."""

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from typing import Final, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from schemas.bounds import MAX_INTEGER, Count, Finite, Kept, Said, StampNs
from schemas.contradiction import ContradictionKind
from service.errors import UsageError

RatesBy = Literal["vehicle", "version", "kind", "hour", "log", "dataset"]
"""Grouping of scenes: `version` is the software version that the car ran, `dataset` the first
folder of the log's id, which names the data set in a bucket of several."""

HOUR_NS: Final = 3600 * NS_PER_S


class RatesRequest(BaseModel):
    """Filter of the current scenes to count, and their grouping."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    by: RatesBy
    since_ns: StampNs = Field(default=0, description="Recorded at or after, ns since the epoch.")
    until_ns: StampNs | None = Field(default=None, description="Recorded before; None: no end.")
    verdicts: bool = Field(
        default=False,
        exclude_if=lambda value: not value,
        description="Give each row its verdicts; absent: no, since earlier clients refuse them.",
    )


class OutcomePoints(BaseModel):
    """Compared points by outcome: the four categories of the paper, in its order."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    both_static: Count = Field(description="Category 1: both streams label them static.")
    both_dynamic: Count = Field(description="Category 2: both label them dynamic.")
    only_predictive_dynamic: Count = Field(description="Category 3.")
    only_semantic_dynamic: Count = Field(description="Category 4.")


class RateRow(BaseModel):
    """One group of current scenes. Rates are shares of the compared points, 0 to 1."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    group: Kept = Field(
        description="Vehicle, software version, kind, hour (RFC 3339), log or data set."
    )
    time: Said | None = Field(default=None, description="By hour: its start, RFC 3339, UTC.")
    time_ms: Count | None = Field(default=None, description="By hour: ms since the Unix epoch.")
    scenes: Count = Field(description="Current scenes.")
    frames: Count = Field(description="Their frames.")
    compared_points: Count = Field(description="Points that both streams labelled.")
    contradicting_points: Count = Field(
        description="Of these, labelled dynamic by exactly one stream; by kind: by that one."
    )
    disagreement_rate: Finite = Field(description="Contradicting over compared points.")
    only_semantic_dynamic_rate: Finite = Field(
        description="Share labelled dynamic by the supervised stream alone, over compared points."
    )
    only_predictive_dynamic_rate: Finite = Field(
        description="Share labelled dynamic by the self-supervised stream alone, over compared "
        "points."
    )
    scenes_with_contradictions: Count = Field(
        description="Scenes with a score above 0; by kind: with a point of that kind."
    )
    gated_scenes: Count = Field(description="Too short, or odometry lost; without a valid score.")
    mean_score: Finite = Field(
        description="Mean over the scenes that are not gated; 0 without any."
    )
    best_score: Finite = Field(description="Highest score of the group.")
    judged_scenes: Count | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Scenes with a verdict that decides which stream is wrong; by kind: scenes "
        "with a strong track of it; absent where it was not requested.",
    )
    right_scenes: Count | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Of these, with a verdict that the supervised stream is wrong.",
    )
    outcomes: OutcomePoints | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="By data set: its compared points by outcome; absent in other groupings.",
    )


@dataclass(frozen=True, slots=True)
class RateSums:
    """Sums over one group of current scenes, as the store makes them.

    Attributes:
        group: Vehicle, version or log; by hour, hours since the Unix epoch; by kind, one for all;
            by data set, the log.
        scenes: Current scenes.
        frames: Their frames.
        compared: Points that both streams labelled.
        both_dynamic: Of these, points that both label dynamic.
        only_semantic: Points that only the supervised stream labels dynamic.
        only_predictive: Points that only the self-supervised stream labels dynamic.
        contradicting_scenes: Scenes with a score above 0.
        semantic_scenes: Scenes with a point of `only_semantic`.
        predictive_scenes: Scenes with a point of `only_predictive`.
        gated_scenes: Scenes without a score.
        score_sum: Sum of the scores of all other scenes.
        best_score: Highest score.
    """

    group: str | int
    scenes: int
    frames: int
    compared: int
    both_dynamic: int
    only_semantic: int
    only_predictive: int
    contradicting_scenes: int
    semantic_scenes: int
    predictive_scenes: int
    gated_scenes: int
    score_sum: float
    best_score: float


def rates(sums: Iterable[RateSums], by: RatesBy) -> list[RateRow]:
    """Make the rows of sums: hours in their order, all other groups worst first."""
    if by == "kind":
        return [row for one in sums for row in _rows_by_kind(one)]
    if by == "dataset":
        rows = [_dataset_row(one) for one in _by_dataset(sums)]
    else:
        rows = [_row(one, by_hour=by == "hour") for one in sums]
    if by == "hour":
        return sorted(rows, key=lambda row: row.time_ms or 0)
    return sorted(rows, key=lambda row: (-row.disagreement_rate, row.group))


@dataclass(frozen=True, slots=True)
class JudgedScene:
    """A current scene with a verdict that decides, in the terms of rates.

    Attributes:
        log_id: Its recording.
        start_ns: Its begin, nanoseconds since the Unix epoch.
        vehicle: Its vehicle.
        software_version: Its software version.
        kinds: Kinds of its strong tracks.
        is_right: True if a verdict is that the supervised stream is wrong.
    """

    log_id: str
    start_ns: int
    vehicle: str
    software_version: str
    kinds: tuple[str, ...]
    is_right: bool


def with_judged(
    rows: Iterable[RateRow], request: RatesRequest, judged: Iterable[JudgedScene]
) -> list[RateRow]:
    """Return the rows of a request with the verdicts on the scenes of each."""
    count: Counter[str] = Counter()
    right: Counter[str] = Counter()
    for scene in judged:
        late = request.until_ns is not None and scene.start_ns >= request.until_ns
        if late or scene.start_ns < request.since_ns:
            continue
        groups = {
            "vehicle": (scene.vehicle,),
            "version": (scene.software_version,),
            "kind": scene.kinds,
            "hour": (_rfc3339(scene.start_ns // HOUR_NS * 3600),),
            "log": (scene.log_id,),
            "dataset": (dataset_of(scene.log_id),),
        }[request.by]
        count.update(groups)
        right.update(groups if scene.is_right else ())
    return [
        row.model_copy(update={"judged_scenes": count[row.group], "right_scenes": right[row.group]})
        for row in rows
    ]


def dataset_of(log_id: str) -> str:
    """Return the first folder of a log's id."""
    return log_id.partition("/")[0]


def _rfc3339(instant_s: int) -> str:
    return datetime.fromtimestamp(instant_s, tz=UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def rates_request(by: str, *, since: str = "", until: str = "", now_s: float) -> RatesRequest:
    """Parse the values that a user or a dashboard gave.

    Args:
        by: One of `RatesBy`.
        since: Earliest time of recording: RFC 3339, a date, an age (`90m`, `24h`, `7d`, `2w`), or
            milliseconds since the Unix epoch (13 digits), as dashboards write it; empty: no limit.
        until: As `since`, but excluded; empty: no limit.
        now_s: Seconds since the Unix epoch, from which `7d` counts back.

    Raises:
        UsageError: If a value is invalid; the message lists valid ones.
    """
    known = get_args(RatesBy)
    if by not in known:
        raise UsageError(f"cannot group by {by!r}; by one of: {', '.join(known)}")
    since_ns, until_ns = instants_ns(since=since, until=until, now_s=now_s)
    return RatesRequest.model_validate({"by": by, "since_ns": since_ns, "until_ns": until_ns})


def instants_ns(*, since: str, until: str, now_s: float) -> tuple[int, int | None]:
    """Parse two times of recording, as `rates_request` does; nanoseconds since the Unix epoch.

    Raises:
        UsageError: If one is no time, or the second is not the later one.
    """
    since_ns = _instant_ns(since, what="since", now_s=now_s) if since else 0
    until_ns = _instant_ns(until, what="until", now_s=now_s) if until else None
    if until_ns is not None and until_ns <= since_ns:
        raise UsageError(f"until ({until}) must be later than since ({since or 'the first scene'})")
    return since_ns, until_ns


def _by_dataset(sums: Iterable[RateSums]) -> list[RateSums]:
    """Add up the sums of all logs of each data set."""
    found: dict[str, RateSums] = {}
    for one in sums:
        name = dataset_of(str(one.group))
        before = found.get(name)
        if before is None:
            found[name] = replace(one, group=name)
            continue
        added = {
            field.name: getattr(before, field.name) + getattr(one, field.name)
            for field in fields(RateSums)
            if field.name not in ("group", "best_score")
        }
        best = max(before.best_score, one.best_score)
        found[name] = RateSums(group=name, best_score=best, **added)
    return list(found.values())


def _dataset_row(sums: RateSums) -> RateRow:
    dynamic = sums.both_dynamic, sums.only_predictive, sums.only_semantic
    outcomes = OutcomePoints(
        both_static=sums.compared - sum(dynamic),
        both_dynamic=dynamic[0],
        only_predictive_dynamic=dynamic[1],
        only_semantic_dynamic=dynamic[2],
    )
    return _row(sums, by_hour=False).model_copy(update={"outcomes": outcomes})


def _row(sums: RateSums, *, by_hour: bool) -> RateRow:
    hour_s = int(sums.group) * 3600 if by_hour else 0
    time = _rfc3339(hour_s)
    return RateRow(
        group=time if by_hour else str(sums.group),
        time=time if by_hour else None,
        time_ms=hour_s * 1000 if by_hour else None,
        scenes=sums.scenes,
        frames=sums.frames,
        compared_points=sums.compared,
        contradicting_points=sums.only_semantic + sums.only_predictive,
        disagreement_rate=_share(sums.only_semantic + sums.only_predictive, sums.compared),
        only_semantic_dynamic_rate=_share(sums.only_semantic, sums.compared),
        only_predictive_dynamic_rate=_share(sums.only_predictive, sums.compared),
        scenes_with_contradictions=sums.contradicting_scenes,
        gated_scenes=sums.gated_scenes,
        mean_score=_share(sums.score_sum, sums.scenes - sums.gated_scenes),
        best_score=sums.best_score,
    )


def _rows_by_kind(sums: RateSums) -> list[RateRow]:
    both = _row(sums, by_hour=False)
    semantic = {
        "group": ContradictionKind.ONLY_SEMANTIC_DYNAMIC.value,
        "contradicting_points": sums.only_semantic,
        "disagreement_rate": both.only_semantic_dynamic_rate,
        "only_predictive_dynamic_rate": 0.0,
        "scenes_with_contradictions": sums.semantic_scenes,
    }
    predictive = {
        "group": ContradictionKind.ONLY_PREDICTIVE_DYNAMIC.value,
        "contradicting_points": sums.only_predictive,
        "disagreement_rate": both.only_predictive_dynamic_rate,
        "only_semantic_dynamic_rate": 0.0,
        "scenes_with_contradictions": sums.predictive_scenes,
    }
    return [both.model_copy(update=semantic), both.model_copy(update=predictive)]


def _share(part: float, whole: float) -> float:
    return round(part / whole, 6) if whole else 0.0


def _instant_ns(text: str, *, what: str, now_s: float) -> int:
    ago = re.fullmatch(r"([0-9]{1,6})([mhdw])", text.strip())
    if ago is not None:
        return max(0, round((now_s - int(ago[1]) * _UNIT_S[ago[2]]) * NS_PER_S))
    if re.fullmatch(r"[0-9]{13}", text.strip()):
        return _within_range(int(text) * 1_000_000, text, what=what)
    try:
        instant = datetime.fromisoformat(text.strip())
    except ValueError:
        raise UsageError(
            f"{what} is no time: {text!r}; give one like 2026-11-20, 2026-11-20T08:00:00Z, or 24h "
            "and 7d for an age"
        ) from None
    if instant.tzinfo is None:
        instant = instant.replace(tzinfo=UTC)
    return _within_range(round(instant.timestamp() * 1e6) * 1000, text, what=what)


def _within_range(instant_ns: int, text: str, *, what: str) -> int:
    if instant_ns > MAX_INTEGER:
        raise UsageError(f"{what} is too late: {text!r}; times end in April 2262")
    return max(0, instant_ns)


_UNIT_S: Final = {"m": 60, "h": 3600, "d": 86_400, "w": 604_800}
