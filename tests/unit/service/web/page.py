"""A review page of a state, asked in this process by a client that keeps cookies as a browser."""

import asyncio
import re
from pathlib import Path
from typing import Any

import httpx

from service.settings.config import load_settings
from service.web.app import make_app
from service.web.settings import WebSettings
from service.web.source import source_of_state

BASE = "http://127.0.0.1:8087"


class Page:
    """Asks an application; every request has a loop of its own."""

    def __init__(self, state: Path, *, key: bytes = b"k" * 32, hosts: tuple[str, ...] = ()) -> None:
        self.app = make_app(
            source_of_state(load_settings(state=state)),
            WebSettings(str(state), key, frozenset(hosts)),
        )
        self.cookies = httpx.Cookies()

    def ask(self, method: str, path: str, **options: Any) -> httpx.Response:
        async def asked() -> httpx.Response:
            transport = httpx.ASGITransport(self.app, raise_app_exceptions=False)
            async with httpx.AsyncClient(
                transport=transport, base_url=BASE, cookies=self.cookies
            ) as client:
                response = await client.request(method, path, **options)
                self.cookies = client.cookies
                return response

        return asyncio.run(asked())

    def get(self, path: str, **options: Any) -> httpx.Response:
        return self.ask("GET", path, **options)

    def post(self, path: str, fields: dict[str, str], **options: Any) -> httpx.Response:
        """Send a form with the token of this visitor, unless the fields have another."""
        return self.ask("POST", path, data={"token": self.token()} | fields, **options)

    def post_json(self, path: str, fields: dict[str, str]) -> httpx.Response:
        return self.post(path, fields, headers={"accept": "application/json"})

    def token(self) -> str:
        found = re.search(r'data-token="([0-9a-f]+)"', self.get("/agreement").text)
        assert found is not None
        return found[1]

    def as_reviewer(self, name: str, *, budget: int = 0) -> "Page":
        answer = self.post("/reviewer", {"name": name, "budget": str(budget or ""), "back": "/"})
        assert answer.status_code == 303, answer.text
        return self

    def scenes(self, query: str = "") -> list[dict[str, Any]]:
        answer = self.get(f"/data/scenes{query}")
        assert answer.status_code == 200, answer.text
        return list(answer.json()["rows"])
