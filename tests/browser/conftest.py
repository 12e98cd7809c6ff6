"""A review page served for Debian's chromium, whose every step is watched for breaches."""

import re
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright

from service.settings.config import load_settings
from service.store.engine import open_store
from service.web.app import make_app
from service.web.server import listening, serving, url_of
from service.web.settings import WebSettings
from service.web.source import source_of_state
from tests.contracts.ledger_world import World
from tests.unit.service.mined_state import mined_state

CHROMIUM = "/usr/bin/chromium"
DESK, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}

_WATCH = """
window.breaches = [];
document.addEventListener("securitypolicyviolation", (e) => breaches.push(e.violatedDirective));
"""


@dataclass
class Review:
    """A served state.

    Attributes:
        url: Its address, without a slash at the end.
        state: Its folder.
        https: The connections of reviewers who need no browser.
    """

    url: str
    state: Path
    https: ExitStack

    def add_log(self, log_id: str) -> None:
        """Mine a further log into the state, as a service would."""
        store = open_store(self.state)
        world = World.on(store)
        world.listed("car-7/a", log_id)
        world.mine_all()
        store.close()

    def client(self, reviewer: str) -> "Client":
        """Return a reviewer who needs no browser."""
        return Client(self.https.enter_context(httpx.Client(base_url=self.url)), reviewer)


class Client:
    """A reviewer who sends forms."""

    def __init__(self, http: httpx.Client, reviewer: str) -> None:
        self._http = http
        found = re.search(r'data-token="([0-9a-f]+)"', http.get("/").text)
        assert found is not None
        self._token = found[1]
        assert self.post("/reviewer", name=reviewer) == 303

    def post(self, path: str, **fields: str) -> int:
        return self._http.post(path, data={"token": self._token} | fields).status_code

    def scenes(self) -> list[dict[str, str]]:
        return list(self._http.get("/data/scenes").json()["rows"])


@pytest.fixture(scope="session")
def mined_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("review") / "state"
    mined_state(folder)
    return folder


@pytest.fixture
def review(tmp_path: Path, mined_once: Path) -> Iterator[Review]:
    state = Path(shutil.copytree(mined_once, tmp_path / "state"))
    settings = WebSettings(str(state), b"k" * 32)
    app = make_app(source_of_state(load_settings(state=state)), settings)
    opened = listening("127.0.0.1:0")
    with serving(app, opened, on_stop=app.state.closing.set), ExitStack() as https:
        yield Review(url_of(opened).rstrip("/"), state, https)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-3d-apis"]
        )
        yield browser
        browser.close()


@dataclass
class Watch:
    """Errors, policy violations and foreign requests of a browser."""

    origin: str
    found: list[str] = field(default_factory=list)

    def over(self, context: BrowserContext) -> None:
        context.add_init_script(_WATCH)
        context.on("request", lambda request: self._request(request.url))
        context.on("console", lambda message: self._said(message.type, message.text))
        context.on("weberror", lambda error: self.found.append(f"error: {error.error}"))

    def _request(self, url: str) -> None:
        if not url.startswith((f"{self.origin}/", "blob:", "data:")):
            self.found.append(f"request: {url}")

    def _said(self, kind: str, text: str) -> None:
        if kind == "error":
            self.found.append(f"console: {text}")


@contextmanager
def opened(
    browser: Browser,
    review: Review,
    path: str = "/",
    *,
    script: bool = True,
    dark: bool = False,
    size: dict[str, int] | None = None,
) -> Iterator[Page]:
    """Open a page; when it is left, nothing foreign was asked and no policy violated."""
    watch = Watch(review.url)
    context = browser.new_context(
        viewport=size or DESK,  # type: ignore[arg-type]
        color_scheme="dark" if dark else "light",
        java_script_enabled=script,
        base_url=review.url,
    )
    watch.over(context)
    page = context.new_page()
    page.set_default_timeout(10_000)
    page.goto(path)
    try:
        yield page
        breaches = page.evaluate("window.breaches") if script else []
    finally:
        context.close()
    assert breaches == []
    assert watch.found == []
