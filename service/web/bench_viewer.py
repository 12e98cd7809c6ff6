"""Benchmark of the scene page in Debian's Chromium: what a reviewer waits for, and its bounds."""

import http.client
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median, quantiles
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote, urlsplit

from service.api.reader import Reader
from service.web.app import make_app
from service.web.context import STATIC
from service.web.server import listening, serving, url_of
from service.web.settings import WebSettings

if TYPE_CHECKING:
    from playwright.sync_api import Browser, CDPSession, Page, Playwright

CHROMIUM: Final = "/usr/bin/chromium"
STAGE: Final = {"width": 1500, "height": 900}
"""Window whose stage has about the 1100 x 760 pixels for which the bounds were set."""

HOST: Final = "review.test"
"""Name of another host for plain HTTP, where browsers do not decompress zstd themselves."""

RUNS: Final = 5
ORBIT_S: Final = 3.0

_WATCH: Final = """
window.breaches = []; window.drawn = []; window.loaded = [];
document.addEventListener("securitypolicyviolation", (e) => breaches.push(e.violatedDirective));
new MutationObserver((all) => all.forEach((one) => {
  const data = document.documentElement.dataset;
  if (one.attributeName === "data-drawn") drawn.push([performance.now(), Number(data.drawn)]);
  if (one.attributeName === "data-loaded") loaded.push([performance.now(), Number(data.loaded)]);
})).observe(document, {subtree: true, attributes: true,
                       attributeFilter: ["data-drawn", "data-loaded"]});
"""

_ORBIT: Final = """
(milliseconds) => new Promise((done) => {
  const canvas = document.querySelector("#left"), gaps = [];
  const send = (type, x) => canvas.dispatchEvent(new PointerEvent(type, {
    pointerId: 1, clientX: x, clientY: 300, bubbles: true, buttons: 1}));
  canvas.setPointerCapture = () => {};
  send("pointerdown", 300);
  const begin = performance.now();
  let last = begin, step = 0;
  const next = (now) => {
    if (step) gaps.push(now - last);
    last = now;
    send("pointermove", 300 + (++step % 2 ? 3 : -3) + step % 200);
    if (now - begin < milliseconds) requestAnimationFrame(next);
    else { send("pointerup", 0); done(gaps); }
  };
  requestAnimationFrame(next);
})
"""

_SCRUB: Final = """
(key) => new Promise((done) => {
  const root = document.documentElement, begin = performance.now();
  const end = () => { watch.disconnect(); done(performance.now() - begin); };
  const watch = new MutationObserver(end);
  watch.observe(root, {attributeFilter: ["data-drawn"]});
  document.body.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true}));
  setTimeout(() => { watch.disconnect(); done(-1); }, 2000);
})
"""

_KEY: Final = """
(key) => new Promise((done) => {
  const begin = performance.now();
  document.body.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true}));
  requestAnimationFrame(() => requestAnimationFrame(() => done(performance.now() - begin)));
})
"""


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured value and its bound.

    Attributes:
        name: What was measured.
        value: The value; a count for what must not happen.
        unit: Its unit; empty for a count.
        bound: The bound; None: the value describes the scene.
        at_least: True if the value must reach the bound; else it must not exceed it.
    """

    name: str
    value: float
    unit: str
    bound: float | None
    at_least: bool = False

    @property
    def is_held(self) -> bool:
        """True if the bound is kept."""
        if self.bound is None:
            return True
        return self.value >= self.bound if self.at_least else self.value <= self.bound


def bench_viewer(source: Reader, scene_id: str) -> Iterator[Figure]:
    """Measure the page of a scene, and yield its figures one by one.

    Args:
        source: State with the scene.
        scene_id: The scene; bounds are for frames of 120,000 points.

    Raises:
        ModuleNotFoundError: If Playwright is not installed.
    """
    from playwright.sync_api import sync_playwright

    yield from _bytes_of(source, scene_id)
    app = make_app(source, WebSettings("bench", b"k" * 32, frozenset({HOST})))
    opened = listening("127.0.0.1:0")
    with serving(app, opened, on_stop=app.state.closing.set), sync_playwright() as playwright:
        url = url_of(opened).rstrip("/")
        path = f"/scene?id={quote(scene_id, safe='')}"
        yield from _served(source, url, scene_id)
        with _browser(playwright) as browser:
            yield from _first_paint(browser, url + path)
            yield from _in_use(browser, url + path)
            yield from _same_pixels(browser, url + path)
        with _browser(playwright, f"--host-resolver-rules=MAP {HOST} 127.0.0.1") as browser:
            port = urlsplit(url).port
            yield from _plain_http(browser, f"http://{HOST}:{port}{path}")


def _bytes_of(source: Reader, scene_id: str) -> Iterator[Figure]:
    code = [*(STATIC / "viewer").glob("*.js"), STATIC / "app.js"]
    yield Figure("page code", sum(_size(path) for path in code) / 1e3, "kB", 80)
    frames = source.overlay_file(scene_id).header.frames
    yield Figure("largest frame", max(frame.points for frame in frames), "points", None)
    yield Figure("largest view block", max(frame.view[1] for frame in frames) / 1e3, "kB", 350)


def _size(path: Path) -> int:
    return path.stat().st_size


def _served(source: Reader, url: str, scene_id: str) -> Iterator[Figure]:
    """Time view blocks over one connection, the first of each with an open overlay."""
    from service.api.overlay_cache import seen_scene

    digest = seen_scene(source, scene_id).digest
    frames = len(source.overlay_file(scene_id).header.frames)
    connection = http.client.HTTPConnection(urlsplit(url).netloc)
    took = []
    for number in [0, *range(frames)]:
        begin = time.perf_counter()
        target = f"/data/frame?id={quote(scene_id, safe='')}&digest={digest}&n={number}"
        connection.request("GET", target)
        connection.getresponse().read()
        took.append(1e3 * (time.perf_counter() - begin))
    connection.close()
    yield Figure("server, a frame", median(took[1:]), "ms", 5)


def _first_paint(browser: "Browser", url: str) -> Iterator[Figure]:
    for name, throttled, bound in (
        ("first paint, cold", False, 500.0),
        ("first paint, cold, 50 Mbit/s and 20 ms", True, 900.0),
    ):
        painted, complete = [], []
        for _ in range(RUNS):
            with _page(browser, url, throttled=throttled) as (page, _):
                drawn = page.evaluate("drawn.find(([, frame]) => frame >= 0)[0]")
                painted.append(float(drawn))
                complete.append(float(page.evaluate("loaded.at(-1)[0]")))
        yield Figure(name, median(painted), "ms", bound)
        if not throttled:
            yield Figure("all frames", median(complete), "ms", 1000)


def _in_use(browser: "Browser", url: str) -> Iterator[Figure]:
    asked: list[str] = []
    with _page(browser, url, asked=asked) as (page, _):
        for name, layout in (("orbit, two views", "both"), ("orbit, one view", "space")):
            page.locator(f"button[data-layout={layout}]").click()
            gaps = page.evaluate(_ORBIT, 1e3 * ORBIT_S)
            yield Figure(name, 1e3 / (sum(gaps) / len(gaps)), "frames/s", 30, at_least=True)
            yield Figure(f"{name}, 95th percentile gap", quantiles(gaps, n=20)[-1], "ms", 40)
        page.locator("button[data-layout=both]").click()
        page.evaluate(_SCRUB, "Home")
        page.wait_for_timeout(200)
        count = int(page.locator("#scrub").get_attribute("max") or 0)
        scrubs = [page.evaluate(_SCRUB, "ArrowRight") for _ in range(count)]
        yield Figure("scrub", median(scrubs), "ms", 50)
        keys = [page.evaluate(_KEY, key) for key in "tlxxccggooea123450"]
        yield Figure("slowest answer to a key", max(keys), "ms", 100)
        yield Figure("memory of the tab, PSS", _renderers_pss(browser) / 1e6, "MB", 300)
        breaches = page.evaluate("breaches")
        yield Figure("violations of the policy", len(breaches), "", 0)
    origin = "{0.scheme}://{0.netloc}/".format(urlsplit(url))
    foreign = [each for each in asked if not each.startswith((origin, "blob:", "data:"))]
    yield Figure("requests to another origin", len(foreign), "", 0)


def _same_pixels(browser: "Browser", url: str) -> Iterator[Figure]:
    seen = set()
    for _ in range(2):
        with _page(browser, url) as (page, _):
            page.wait_for_timeout(300)
            panes = [page.locator(each) for each in ("#left", "#right")]
            seen.add(tuple(pane.evaluate("canvas => canvas.toDataURL()") for pane in panes))
    yield Figure("runs with other pixels", len(seen) - 1, "", 0)


def _plain_http(browser: "Browser", url: str) -> Iterator[Figure]:
    with _page(browser, url) as (page, _):
        ready = page.evaluate("drawn.find(([, frame]) => frame >= 0)[0]")
    yield Figure("first paint over plain HTTP by a host name", float(ready), "ms", 900)


@contextmanager
def _browser(playwright: "Playwright", *arguments: str) -> Iterator["Browser"]:
    options = ["--no-sandbox", "--disable-3d-apis", *arguments]
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
    try:
        yield browser
    finally:
        browser.close()


@contextmanager
def _page(
    browser: "Browser", url: str, *, throttled: bool = False, asked: list[str] | None = None
) -> Iterator[tuple["Page", "CDPSession"]]:
    """Open a page with a cold cache, and wait until every frame is there."""
    context = browser.new_context(viewport=STAGE)  # type: ignore[arg-type]
    context.add_init_script(_WATCH)
    if asked is not None:
        context.on("request", lambda request: asked.append(request.url))
    page = context.new_page()
    session = context.new_cdp_session(page)
    if throttled:
        rate = 50e6 / 8
        session.send("Network.enable")
        session.send(
            "Network.emulateNetworkConditions",
            {"offline": False, "latency": 20, "downloadThroughput": rate, "uploadThroughput": rate},
        )
    try:
        page.goto(url)
        count = int(page.locator("#scrub").get_attribute("max") or 0) + 1
        page.locator(f'html[data-loaded="{count}"]').wait_for(state="attached")
        page.locator('html[data-drawn]:not([data-drawn="-1"])').wait_for(state="attached")
        yield page, session
    finally:
        context.close()


def _renderers_pss(browser: "Browser") -> float:
    """Return the proportional memory of the largest process that renders pages, bytes."""
    session = browser.new_browser_cdp_session()
    found: list[dict[str, Any]] = session.send("SystemInfo.getProcessInfo")["processInfo"]
    session.detach()
    return max(_pss(int(each["id"])) for each in found if each["type"] == "renderer")


def _pss(process: int) -> float:
    rollup = Path(f"/proc/{process}/smaps_rollup")
    if not os.access(rollup, os.R_OK):
        return 0.0
    line = next(each for each in rollup.read_text().splitlines() if each.startswith("Pss:"))
    return 1024.0 * int(line.split()[1])
