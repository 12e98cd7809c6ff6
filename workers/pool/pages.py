"""HTTP pages of a pool for monitoring: metrics, liveness, readiness."""

from collections.abc import Callable, Mapping
from typing import Protocol

from prometheus_client import CollectorRegistry

from schemas.runtime.http_endpoint import (
    Handler,
    HttpRequest,
    HttpResponse,
    metrics_route,
    text_response,
)


class WatchedPool(Protocol):
    """A pool that says what it lacks."""

    @property
    def registry(self) -> CollectorRegistry:
        """Metrics of the pool."""
        ...

    def check_alive(self) -> None:
        """Raise the reason if the pool no longer monitors its workers."""
        ...

    def check_ready(self) -> None:
        """Raise the reason if no worker could take a lease now."""
        ...


def pool_pages(pool: WatchedPool) -> Mapping[str, Handler]:
    """Return `/metrics`, `/healthz` (it lives) and `/readyz` (a worker could take a lease)."""
    return {
        "/metrics": metrics_route(pool.registry),
        "/healthz": _unless_it_raises(pool.check_alive),
        "/readyz": _unless_it_raises(pool.check_ready),
    }


def _unless_it_raises(check: Callable[[], None]) -> Handler:
    """Return a handler that answers `ok`; the endpoint turns an exception into "unavailable"."""

    def answer(_request: HttpRequest) -> HttpResponse:
        check()
        return text_response("ok")

    return answer
