"""Routes of what adds up over scenes: progress, failure modes, rates and activity."""

from importlib.metadata import version
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.requests import Request
from starlette.responses import Response

from service.api.messages import AboutReply, RatesReply, RetryReply, RetryRequest
from service.curation.activity import ActivityRequest
from service.curation.comparison import CompareRequest
from service.curation.rates import RatesRequest
from service.http.context import answer, route, source_of, turn_of

router = APIRouter(tags=["sums"])

PACKAGE = version("counterpoint")  # read at the start: an upgrade changes the files


@route(router, "about", summary="Version")
def about(request: Request) -> Response:
    """Return the version of the program."""
    return answer(AboutReply(package=PACKAGE))


@route(router, "status", summary="Progress")
def status(request: Request) -> Response:
    """Return the progress of planning and mining."""
    with turn_of(request) as source:
        return answer(source.status())


@route(router, "modes", summary="Failure modes")
def modes(request: Request) -> Response:
    """Group the strong tracks of the current scenes into failure modes."""
    with turn_of(request) as source:
        return answer(source.modes())


@route(router, "compare", summary="Compare two versions")
def compare(request: Request, asked: CompareRequest) -> Response:
    """Compare two software or pipeline versions by kind, class and mode; store nothing."""
    with turn_of(request) as source:
        return answer(source.compare(asked))


@route(router, "rates", summary="Rates of contradictions")
def rates(request: Request, asked: Annotated[RatesRequest, Query()]) -> Response:
    """Count contradictions by vehicle, software version, kind, hour or log."""
    with turn_of(request) as source:
        return answer(RatesReply(rows=tuple(source.rates(asked))))


@route(router, "activity", summary="Activity")
def activity(request: Request, asked: Annotated[ActivityRequest, Query()]) -> Response:
    """Return scenes, disagreement, verdicts and precision over time and by group."""
    with turn_of(request) as source:
        return answer(source.activity(asked))


@route(router, "retry", summary="Retry parked work")
def retry(request: Request, asked: RetryRequest) -> Response:
    """Retry parked work, of these logs or all, or all refused logs; return what it was."""
    retried = source_of(request).retry(asked.log_ids, refused=asked.refused)
    return answer(RetryReply(retried=tuple(retried)))
