"""Absurd questions to `/rates` are answered by a sentence, never as a failure of the page."""

from collections.abc import Iterator
from pathlib import Path
from typing import cast
from urllib.error import HTTPError
from urllib.parse import quote
from urllib.request import urlopen

import pytest
from prometheus_client import CollectorRegistry
from structlog.testing import capture_logs

from schemas.runtime.http_endpoint import HttpEndpoint
from service.monitoring.http_pages import pages
from service.monitoring.readiness import Watched
from service.store.engine import open_store
from tests.contracts.ledger_world import World


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    """The rates of an empty ledger; nothing here asks how the service is."""
    store = open_store(tmp_path)
    routes = pages(cast(Watched, None), World.on(store).ledger, CollectorRegistry())
    with HttpEndpoint("127.0.0.1:0", routes) as endpoint:
        yield f"{endpoint.url}/rates"
    store.close()


def answered(url: str) -> tuple[int, str]:
    try:
        with urlopen(url, timeout=10) as answer:  # noqa: S310
            return answer.status, answer.read().decode()
    except HTTPError as refused:
        with refused:
            return refused.code, refused.read().decode()


@pytest.mark.parametrize(
    "query",
    [
        "until=9999-12-31",
        "until=9999-12-31T23:59:59.999999%2B00:00",
        "since=9999-12-31T23:59:59-23:59",
        "since=9999999999999",
        "until=9999999999999",
        "until=2263-01-01",
        "until=0001-01-01",
        "since=2026-11-20&until=0001-01-01T00:00:00%2B23:59",
        "until=nan",
        "since=inf",
        "since=1e400",
        "since=-1",
        "since=999999999999999999w",
        "since=" + quote("٩٩٩٩٩٩٩٩٩٩٩٩٩"),
        "since=" + quote("९९९९९९d x"),
        "by=",
        "by=day",
        "by=hour&by=hour",
        "by=" + "a" * 2000,
        "by=%00",
        "by=" + "a" * 1_000_000,
        "=",
        "&&&=hour",
        "By=hour",
    ],
    ids=lambda query: query[:40],
)
def test_a_question_that_cannot_be_meant_is_400_and_a_sentence(url: str, query: str) -> None:
    with capture_logs() as events:
        status, said = answered(f"{url}?{query}")
    assert status == 400
    assert said.count("\n") == 1
    assert 20 < len(said) < 3000
    assert not [event for event in events if event["log_level"] == "error"]


@pytest.mark.parametrize("query", ["", "since=", "since=1d&until=", "until=2262-01-01&by=log"])
def test_a_question_that_can_be_meant_is_answered(url: str, query: str) -> None:
    assert answered(f"{url}?{query}") == (200, "[]\n")
