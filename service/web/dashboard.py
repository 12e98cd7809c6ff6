"""Dashboard: disagreement, verdicts and precision over time and by group, and the mining."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final, Literal, cast
from urllib.parse import urlencode

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from service.api.reader import Reader
from service.curation.activity import (
    ActivityGroup,
    ActivityPer,
    ActivityReply,
    ActivityRequest,
    JudgedBucket,
    RecordedBucket,
)
from service.curation.rates import RatesRequest, rates_request
from service.curation.status import Status
from service.curation.verdicts import Precision
from service.errors import UsageError
from service.web.charts import Chart, Sample, bar_chart, line_chart
from service.web.context import render, source_of
from service.web.kept import Kept
from service.web.phrases import counted, interval, kind_name, percent
from service.web.ranking import kind_class

router = APIRouter()

MOST_SAMPLES: Final = 120
"""Hours or days of a chart at most, the latest ones."""

KEPT_S: Final = 10.0
"""Age up to which a dashboard is shown again, seconds: it counts all scenes."""

PATIENCE_S: Final = 4.0
"""Time that a dashboard waits for the counts, seconds; then the page loads itself again."""

FEW_DAYS: Final = 4
"""Days up to which a chart shows hours unless days are asked for."""

Shown = tuple[ActivityPer, ActivityReply, Status]
"""Step of the charts, the activity, and the status."""

_SPAN_MS: Final = {"hour": 3_600_000, "day": 86_400_000}
_PARAMETER: Final = {"vehicle": "vehicle", "version": "version", "kind": "kind"}
_TITLES: Final = {"vehicle": "Vehicle", "version": "Software version", "kind": "Kind"}


@dataclass(frozen=True, slots=True)
class GroupRow:
    """A row of a table by vehicle, version or kind.

    Attributes:
        name: Name of the group in words.
        href: Address of its scenes.
        share: Its rate in proportion to the largest of the table, for the bar.
        kind_class: Class of the colour of the bar.
        row: Its numbers.
        precision: Precision with its interval; empty without a verdict.
    """

    name: str
    href: str
    share: float
    kind_class: str
    row: ActivityGroup
    precision: str


@router.get("/dashboard")
def dashboard(request: Request) -> Response:
    """Answer with the dashboard."""
    source, query = source_of(request), request.query_params
    since, until, wanted = (query.get(name, "").strip() for name in ("since", "until", "per"))
    times = rates_request(
        "hour", since=since, until=until, now_s=time.clock_gettime(time.CLOCK_REALTIME)
    )
    kept = cast(Kept[Shown], request.app.state.activity)
    shown = kept.within(
        (since, until, wanted),
        lambda: (*_activity(source, times, wanted), source.status()),
        patience_s=PATIENCE_S,
    )
    given = {"since": since, "until": until, "per": wanted}
    if shown is None:
        return render(request, "counting.html", section="dashboard", given=given)
    per, found, status = shown
    return render(
        request,
        "dashboard.html",
        section="dashboard",
        given=given,
        per=per,
        disagreement=_disagreement(found.recorded, per),
        recorded=_recorded(found.recorded, per),
        precision=_precision(found.judged, per),
        judged=_judged(found.judged, per),
        cut=max(len(found.recorded), len(found.judged)) > MOST_SAMPLES,
        most=MOST_SAMPLES,
        tables=[(_TITLES[by], _table(found.groups, by)) for by in ("vehicle", "version", "kind")],
        mining=status,
        so_far=_phrase(found.judged[-1].so_far) if found.judged else "",
        verdicts=sum(each.verdicts for each in found.judged),
        contradicting=_share_of(status),
        waiting=sum(
            count for state, count in status.shards_by_state.items() if state not in _SETTLED
        ),
        behind=status.last_seq - status.published_seq,
    )


_SETTLED: Final = frozenset({"done", "parked"})


def _activity(
    source: Reader, times: RatesRequest, wanted: str
) -> tuple[ActivityPer, ActivityReply]:
    """Ask for hours or days as wanted; if neither is, for hours where there are few days.

    Raises:
        UsageError: If it is wanted by something else.
    """
    if wanted not in ("", *_SPAN_MS):
        raise UsageError(f"a dashboard is per hour or per day, not {wanted[:40]!r}")

    def per(name: ActivityPer) -> ActivityReply:
        return source.activity(
            ActivityRequest(per=name, since_ns=times.since_ns, until_ns=times.until_ns)
        )

    if wanted == "hour":
        return "hour", per("hour")
    found = per("day")
    if wanted == "day" or max(len(found.recorded), len(found.judged)) > FEW_DAYS:
        return "day", found
    return "hour", per("hour")


def _sample(
    time_ms: int,
    per: ActivityPer,
    value: float | None,
    words: str,
    href: str,
    *bounds: float | None,
) -> Sample:
    """Return the sample of an hour or a day, named by it."""
    at = time_ms // _SPAN_MS[per]
    return Sample(at, _tick(time_ms, per), value, f"{_label(time_ms, per)}: {words}", href, *bounds)


def _disagreement(buckets: Sequence[RecordedBucket], per: ActivityPer) -> Chart:
    return line_chart(
        [
            _sample(
                each.time_ms,
                per,
                each.disagreement_rate,
                f"{percent(each.disagreement_rate, 2)} of the points, "
                f"{counted(each.scenes, 'scene')}",
                _recorded_in(each.time_ms, per),
            )
            for each in buckets[-MOST_SAMPLES:]
        ],
        percent=True,
    )


def _recorded(buckets: Sequence[RecordedBucket], per: ActivityPer) -> Chart:
    return bar_chart(
        [
            _sample(
                each.time_ms,
                per,
                each.scenes,
                f"{counted(each.scenes, 'scene')}, mean score {each.mean_score:.3f}",
                _recorded_in(each.time_ms, per),
            )
            for each in buckets[-MOST_SAMPLES:]
        ]
    )


def _precision(buckets: Sequence[JudgedBucket], per: ActivityPer) -> Chart:
    return line_chart(
        [
            _sample(
                each.time_ms,
                per,
                each.so_far.share,
                f"precision so far {_phrase(each.so_far)}, "
                f"{each.so_far.right} of {each.so_far.judged}",
                "/?judged=yes&sort=judged",
                each.so_far.low,
                each.so_far.high,
            )
            for each in buckets[-MOST_SAMPLES:]
        ],
        top=1.0,
    )


def _judged(buckets: Sequence[JudgedBucket], per: ActivityPer) -> Chart:
    return bar_chart(
        [
            _sample(
                each.time_ms,
                per,
                each.verdicts,
                counted(each.verdicts, "verdict"),
                "/?judged=yes&sort=judged",
            )
            for each in buckets[-MOST_SAMPLES:]
        ]
    )


def _table(
    groups: Sequence[ActivityGroup], by: Literal["vehicle", "version", "kind"]
) -> list[GroupRow]:
    rows = sorted(
        (each for each in groups if each.by == by), key=lambda row: -row.disagreement_rate
    )
    most = max((each.disagreement_rate for each in rows), default=0.0) or 1.0
    return [
        GroupRow(
            name=kind_name(each.group) if by == "kind" else each.group,
            href=f"/?{urlencode({_PARAMETER[by]: each.group})}",
            share=each.disagreement_rate / most,
            kind_class=kind_class(each.group) if by == "kind" else "",
            row=each,
            precision=_phrase(each.precision),
        )
        for each in rows
    ]


def _phrase(found: Precision) -> str:
    if found.share is None or found.low is None or found.high is None:
        return ""
    return interval(found.share, found.low, found.high)


def _label(time_ms: int, per: ActivityPer) -> str:
    try:
        at = datetime.fromtimestamp(time_ms / 1000, tz=UTC)
    except (OverflowError, ValueError, OSError):  # a clock that was never set
        return str(time_ms)
    return f"{at:%Y-%m-%d %H:%M}" if per == "hour" else f"{at:%Y-%m-%d}"


def _tick(time_ms: int, per: ActivityPer) -> str:
    """Return a label of the time axis, which leaves out the year and, of hours, the month."""
    label = _label(time_ms, per)
    return label[8:] if per == "hour" else label[5:]


def _recorded_in(time_ms: int, per: ActivityPer) -> str:
    """Return the address of the scenes recorded in an hour or a day."""
    begin, end = (
        datetime.fromtimestamp(ms / 1000, tz=UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        for ms in (time_ms, time_ms + _SPAN_MS[per])
    )
    return f"/?{urlencode({'since': begin, 'until': end})}"


def _share_of(status: Status) -> float | None:
    """Return the share of the compared points that contradict; None without any."""
    points = status.points
    contradicting = points.only_semantic_dynamic + points.only_predictive_dynamic
    compared = contradicting + points.both_static + points.both_dynamic
    return contradicting / compared if compared else None
