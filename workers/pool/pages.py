"""HTTP pages of a pool for monitoring: metrics, liveness, readiness."""

from collections.abc import Callable, Mapping

from schemas.runtime.http_endpoint import (
    Handler,
    HttpRequest,
    HttpResponse,
    metrics_route,
    text_response,
)
from workers.pool.local import LocalPool


def pool_pages(pool: LocalPool) -> Mapping[str, Handler]:
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
