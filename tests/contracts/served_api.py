"""A review page with its REST API on a real port, and what asks it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from service.api.reader import Reader
from service.client import Counterpoint
from service.settings.config import load_settings
from service.web.app import make_app
from service.web.server import listening, serving, url_of
from service.web.settings import WebSettings
from service.web.source import source_of_state

API = "/api/v1"

TIMEOUT_S = 60.0
"""Time for an answer on a busy machine, seconds."""


class ServedApi:
    """The page of one state, while its `with` block is open.

    Attributes:
        url: Address of the page.
        source: Data source of the page.
        client: Client of the page.
    """

    def __init__(self, url: str, source: Reader) -> None:
        self.url, self.source = url, source
        self.client = Counterpoint(url)

    def get(self, path: str, **options: Any) -> httpx.Response:
        return httpx.get(f"{self.url}{API}{path}", timeout=TIMEOUT_S, **options)

    def post(self, path: str, body: object, *, key: str = "") -> httpx.Response:
        headers = {"idempotency-key": key} if key else {}
        return httpx.post(f"{self.url}{API}{path}", json=body, headers=headers, timeout=TIMEOUT_S)


@contextmanager
def served_api(state: Path, *, database: str | None = None) -> Iterator[ServedApi]:
    """Serve the page of a state."""
    source = source_of_state(load_settings(state=state, database=database))
    app = make_app(source, WebSettings(str(state), b"k" * 32, frozenset()))
    opened = listening("127.0.0.1:0")
    with serving(app, opened, on_stop=app.state.closing.set):
        yield ServedApi(url_of(opened).rstrip("/"), source)
