"""Activity of the current scenes and of the verdicts, by hour or day and by group."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from sqlalchemy import ColumnElement, Connection, Table, case, func, select

from schemas.arrays import NS_PER_S
from schemas.verdict import DECIDED, RIGHT, Verdict
from service.curation.activity import (
    MAX_BUCKETS,
    MAX_GROUPS,
    ActivityBy,
    ActivityGroup,
    ActivityReply,
    ActivityRequest,
    JudgedBucket,
    RecordedBucket,
)
from service.curation.verdicts import CAUSES, MAX_CHOICES, ChoicesReply, Precision, precision_of
from service.store.listed_scenes import names_in
from service.store.served_bucket import served_bucket
from service.store.tables import LISTED_SCENES, LISTING_FINDINGS, LISTING_SOURCES, VERDICTS

_BUCKET_S: Final = {"hour": 3600, "day": 86_400}
_C: Final = LISTED_SCENES.c


def activity(connection: Connection, request: ActivityRequest) -> ActivityReply:
    """Sum up scenes by time of recording, and verdicts by time of judging."""
    bucket_s = _BUCKET_S[request.per]
    verdicts = connection.execute(_VERDICTS).all()
    asked = [row for row in verdicts if _is_within(row, request)]
    return ActivityReply(
        recorded=tuple(_recorded(connection, request, bucket_s=bucket_s)),
        judged=tuple(_judged(verdicts, request, bucket_s=bucket_s))[-MAX_BUCKETS:],
        groups=tuple(_groups(connection, request, asked)),
    )


def choices(connection: Connection, *, causes: Sequence[str]) -> ChoicesReply:
    """Return the values that filters and verdicts choose from; `causes` are the user's own."""
    sources, findings = LISTING_SOURCES.c, LISTING_FINDINGS.c

    def values(column: ColumnElement[Any]) -> tuple[str, ...]:
        found = connection.execute(select(column).distinct().order_by(column).limit(MAX_CHOICES))
        return tuple(found.scalars())

    def members(column: ColumnElement[Any]) -> tuple[str, ...]:
        sets = connection.execute(select(column).distinct()).scalars()
        return tuple(sorted({name for each in sets for name in names_in(each)}))[:MAX_CHOICES]

    return ChoicesReply(
        vehicles=values(sources.vehicle),
        software_versions=values(sources.software_version),
        kinds=members(findings.kinds),
        class_names=members(findings.class_names),
        modes=values(sources.mode),
        reviewers=values(VERDICTS.c.reviewer),
        causes=(*CAUSES, *causes)[:MAX_CHOICES],
        bucket=served_bucket(connection),
    )


def _recorded(
    connection: Connection, request: ActivityRequest, *, bucket_s: int
) -> Iterator[RecordedBucket]:
    bucket = (_C.start_ns // (bucket_s * NS_PER_S)).label("bucket")
    scored = case((_C.place <= 0, 1), else_=0)
    rows = connection.execute(
        select(
            bucket,
            *_SUMS,
            func.sum(scored).label("scored"),
            func.sum(case((_C.place <= 0, -_C.place), else_=0.0)).label("score_sum"),
        )
        .where(*_recorded_within(request))
        .group_by(bucket)
        .order_by(bucket.desc())
        .limit(MAX_BUCKETS)
    ).all()
    for row in reversed(rows):
        yield RecordedBucket(
            time_ms=row.bucket * bucket_s * 1000,
            scenes=row.scenes,
            disagreement_rate=_rate(row.contradicting, row.compared),
            mean_score=float(row.score_sum) / int(row.scored) if row.scored else 0.0,
        )


def _judged(
    verdicts: Sequence[Any], request: ActivityRequest, *, bucket_s: int
) -> Iterator[JudgedBucket]:
    by_bucket: defaultdict[int, list[Any]] = defaultdict(list)
    for row in verdicts:
        by_bucket[int(row.judged_s // bucket_s)].append(row)
    so_far = _Outcome()
    for bucket in sorted(by_bucket):
        rows = by_bucket[bucket]
        so_far.add(rows)
        within = [row for row in rows if _is_within(row, request)]
        if within:
            yield JudgedBucket(
                time_ms=bucket * bucket_s * 1000,
                verdicts=len(within),
                precision=_Outcome.of(within).precision,
                so_far=so_far.precision,
            )


@dataclass(slots=True)
class _Outcome:
    """Records that are judged, and of these the right ones, as in `Precision`."""

    judged: set[tuple[str, str]] = field(default_factory=set)
    right: set[tuple[str, str]] = field(default_factory=set)

    @classmethod
    def of(cls, rows: Iterable[Any]) -> "_Outcome":
        outcome = cls()
        outcome.add(rows)
        return outcome

    def add(self, rows: Iterable[Any]) -> None:
        for row in rows:
            verdict, record = Verdict(row.verdict), (row.scene_id, row.sha256)
            if verdict in DECIDED:
                self.judged.add(record)
            if verdict in RIGHT:
                self.right.add(record)

    @property
    def precision(self) -> Precision:
        return precision_of(len(self.right), len(self.judged))


def _groups(
    connection: Connection, request: ActivityRequest, verdicts: Sequence[Any]
) -> Iterator[ActivityGroup]:
    sources = _by_number(connection, request, _C.source, LISTING_SOURCES)
    findings = _by_number(connection, request, _C.finding, LISTING_FINDINGS)
    yield from _of("vehicle", ((row, (row.vehicle,)) for row in sources), verdicts)
    yield from _of("version", ((row, (row.software_version,)) for row in sources), verdicts)
    yield from _of("kind", ((row, names_in(row.kinds)) for row in findings), verdicts)


def _by_number(
    connection: Connection, request: ActivityRequest, number: ColumnElement[int], table: Table
) -> Sequence[Any]:
    """Return the sums over each source or finding, with its values."""
    sums = (
        select(number.label("number"), *_SUMS)
        .where(*_recorded_within(request))
        .group_by(number)
        .subquery()
    )
    key = table.primary_key.columns.values()[0]
    return connection.execute(select(sums, table).join(table, key == sums.c.number)).all()


def _of(
    by: ActivityBy, rows: Iterable[tuple[Any, Sequence[str]]], verdicts: Sequence[Any]
) -> list[ActivityGroup]:
    sums: defaultdict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    for row, groups in rows:
        for group in groups:
            for place, value in enumerate((row.scenes, row.compared, row.contradicting)):
                sums[group][place] += int(value)
    on: defaultdict[str, list[Any]] = defaultdict(list)
    for verdict in verdicts:
        for group in _groups_of(by, verdict):
            on[group].append(verdict)
    most = sorted(sums, key=lambda group: (-sums[group][0], group))[:MAX_GROUPS]
    return [
        ActivityGroup(
            by=by,
            group=group,
            scenes=sums[group][0],
            disagreement_rate=_rate(sums[group][2], sums[group][1]),
            verdicts=len(on[group]),
            precision=_Outcome.of(on[group]).precision,
        )
        for group in most
    ]


def _groups_of(by: ActivityBy, verdict: Any) -> Sequence[str]:
    if by == "kind":
        return names_in(verdict.kinds)
    return (verdict.vehicle if by == "vehicle" else verdict.software_version,)


def _recorded_within(request: ActivityRequest) -> list[ColumnElement[bool]]:
    found: list[ColumnElement[bool]] = []
    if request.since_ns:
        found.append(_C.start_ns >= request.since_ns)
    if request.until_ns is not None:
        found.append(_C.start_ns < request.until_ns)
    return found


def _is_within(verdict: Any, request: ActivityRequest) -> bool:
    at_ns = verdict.judged_s * NS_PER_S
    return bool(
        at_ns >= request.since_ns and (request.until_ns is None or at_ns < request.until_ns)
    )


def _rate(contradicting: Any, compared: Any) -> float:
    return int(contradicting) / int(compared) if compared else 0.0  # PostgreSQL sums to decimals


_SUMS: Final = (
    func.count().label("scenes"),
    func.sum(_C.compared).label("compared"),
    func.sum(_C.contradicting).label("contradicting"),
)
_V: Final = VERDICTS.c
_VERDICTS: Final = (
    select(
        _V.scene_id,
        _V.sha256,
        _V.verdict,
        _V.judged_s,
        _V.vehicle,
        _V.software_version,
        _V.kinds,
    )
    .where(_V.is_current)
    .order_by(_V.ordinal)
)
