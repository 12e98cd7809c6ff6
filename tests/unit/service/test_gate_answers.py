"""Refusals of the gate: problem details to callers of the API, one sentence of text to browsers."""

import asyncio

import httpx
import pytest
from starlette.responses import PlainTextResponse

from service.web.gate import Gate
from service.web.roles import Doors


def asked(path: str, *, times: int) -> httpx.Response:
    """Ask a page with a rate of one request a second so often; return the last answer."""
    gate = Gate(PlainTextResponse("page"), doors=Doors(), rate=1.0)

    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(app=gate)
        async with httpx.AsyncClient(transport=transport, base_url="http://page") as client:
            for _ in range(times - 1):
                await client.get(path)
            return await client.get(path)

    return asyncio.run(ask())


@pytest.mark.parametrize("path", ["/api/v1/status", "/"])
def test_requests_within_the_rate_are_answered(path: str) -> None:
    assert asked(path, times=5).text == "page"


def test_a_caller_of_the_api_that_is_too_fast_gets_problem_details() -> None:
    answer = asked("/api/v1/status", times=12)
    assert answer.status_code == 429
    assert answer.headers["content-type"] == "application/problem+json"
    assert int(answer.headers["retry-after"]) >= 1
    assert answer.json()["detail"] == "too many requests; ask again later"


def test_a_browser_that_is_too_fast_gets_a_sentence() -> None:
    answer = asked("/", times=12)
    assert (answer.status_code, answer.text) == (429, "too many requests; ask again later\n")
