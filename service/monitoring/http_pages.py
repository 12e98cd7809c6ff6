"""HTTP pages of the service: metrics, liveness, readiness, and rates."""

from collections.abc import Callable, Iterator, Mapping
from http import HTTPStatus
from typing import Protocol

from prometheus_client import CollectorRegistry
from prometheus_client.core import Metric
from prometheus_client.registry import Collector

from schemas.bounds import MAX_INTEGER
from schemas.runtime.http_endpoint import (
    Handler,
    HttpRequest,
    HttpResponse,
    json_response,
    metrics_route,
    text_response,
)
from service.curation.rates import RatesRequest, rates, rates_request, with_judged
from service.errors import UsageError
from service.monitoring.gauges import active_gauge
from service.monitoring.readiness import Watched
from service.store.ledger import Ledger


def pages(
    watched: Watched, ledger: Ledger, *registries: CollectorRegistry
) -> Mapping[str, Handler]:
    """Make the handlers of a service, running or starting, by path.

    Args:
        watched: Source of liveness and readiness.
        ledger: Source of the rates.
        registries: Source of `/metrics`.
    """
    return {
        "/metrics": metrics_route(*registries),
        "/healthz": lambda _: _health(watched.check),
        "/readyz": lambda _: _readiness(watched.not_ready()),
        "/rates": lambda request: _rates(ledger, request),
    }


class StandingBy(Protocol):
    """Interface of a service that stands by."""

    @property
    def problem(self) -> str:
        """Cause for which it could not take over now; empty: it could."""
        ...


def standby_pages(standby: StandingBy) -> Mapping[str, Handler]:
    """Make the handlers of a service that stands by; it is ready if it sees its database."""

    def readiness(_: HttpRequest) -> HttpResponse:
        problem = standby.problem
        return _readiness({"database": problem} if problem else {}, role="standby")

    registry = CollectorRegistry()
    registry.register(_StandbyGauge())
    return {
        "/metrics": metrics_route(registry),
        "/healthz": lambda _: text_response("alive"),
        "/readyz": readiness,
    }


class _StandbyGauge(Collector):
    """The only metric of a standby."""

    def collect(self) -> Iterator[Metric]:
        """Yield that it does not serve."""
        yield active_gauge(is_active=False)


def _health(check: Callable[[], None]) -> HttpResponse:
    check()  # a bug that ended a thread is answered by 500 and logged, an idle pool by 503
    return text_response("alive")


def _readiness(problems: Mapping[str, str], *, role: str = "active") -> HttpResponse:
    status = HTTPStatus.SERVICE_UNAVAILABLE if problems else HTTPStatus.OK
    answer = {"ready": not problems, "role": role, "problems": problems}
    return json_response(answer, status=status)


def _rates(ledger: Ledger, request: HttpRequest) -> HttpResponse:
    """Answer `?by=…&since=…&until=…` with an array of flat rows."""
    unknown = sorted(request.query.keys() - {"by", "since", "until"})
    if unknown:
        raise UsageError(f"unknown parameter {unknown[0]!r}; known: by, since, until")
    asked = _asked_rates(request.query, now_s=ledger.now_s())
    rows = rates(ledger.rate_sums(asked), asked.by)
    rows = with_judged(rows, asked, ledger.verdicts.judged_scenes())
    return json_response([row.model_dump(mode="json", exclude_none=True) for row in rows])


def _asked_rates(query: Mapping[str, str], *, now_s: float) -> RatesRequest:
    """Parse the parameters.

    Raises:
        UsageError: If one of them is invalid, or an instant that no database keeps.
    """
    try:
        asked = rates_request(
            query.get("by", "hour"),
            since=query.get("since", ""),
            until=query.get("until", ""),
            now_s=now_s,
        )
    except (ValueError, OverflowError) as error:
        raise UsageError(f"since and until are years from 1970 to 2261: {dict(query)}") from error
    if max(asked.since_ns, asked.until_ns or 0) > MAX_INTEGER:
        raise UsageError(f"since and until are years from 1970 to 2261: {dict(query)}")
    return asked
