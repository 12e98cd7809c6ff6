"""Floods the review page of a real process: `python -m tests.integration.http_flood`.

Clients send requests as fast as they are answered: right, malformed and large ones.
"""

import argparse
import json
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import asdict, dataclass
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Final

from tests.fuzz.asked_pages import AskedPages, asked_pages

PATIENCE_S: Final = 20.0

ASKED: Final[tuple[tuple[str, str, bytes], ...]] = (
    ("GET", "/", b""),
    ("GET", "/api/v1/scenes?most=500", b""),
    ("GET", "/api/v1/scenes/none", b""),
    ("GET", "/scene/none", b""),
    ("GET", "/%00" + "x" * 2_000, b""),
    ("POST", "/api/v1/selections", b"{"),
    ("POST", "/api/v1/verdicts", b'{"key":"' + b"x" * 100_000 + b'"}'),
    ("POST", "/api/v1/selections", b"[" * 1_000_000),
    ("BREW", "/", b""),
)


@dataclass(frozen=True, slots=True)
class HttpFlooded:
    """Figures of a flood of requests.

    Attributes:
        statuses: Status to number of answers; 0: a connection that ended without one.
        seconds: Until the last request had ended.
        recovered_s: From then to the first answer to a page, seconds.
        before_mb: Most memory of the page before, megabytes.
        peak_mb: Most memory of the page until the end, megabytes.
        deaths: Processes that ended.
    """

    statuses: dict[int, int]
    seconds: float
    recovered_s: float
    before_mb: int
    peak_mb: int
    deaths: int


def flood(folder: Path, *, requests: int, clients: int, rate: int) -> HttpFlooded:
    """Start a page, flood it, and see whether it still answers.

    Args:
        folder: For states and logs.
        requests: In all.
        clients: Threads that share them.
        rate: Requests a second that one client may send; 0: no limit.
    """
    with asked_pages(folder, rate=rate) as pages:
        before_mb, began_s = pages.report.peak_mb["page"], time.monotonic()
        counts = flood_page(pages.page.removeprefix("http://"), requests=requests, clients=clients)
        ended_s = time.monotonic()
        recovered_s = _until_answered(pages) - ended_s
        pages.look()
        return HttpFlooded(
            statuses=dict(sorted(counts.items())),
            seconds=round(ended_s - began_s, 1),
            recovered_s=round(recovered_s, 2),
            before_mb=before_mb,
            peak_mb=pages.report.peak_mb["page"],
            deaths=pages.report.deaths,
        )


def flood_page(address: str, *, requests: int, clients: int) -> Counter[int]:
    """Send requests from several clients at once.

    Args:
        address: `host:port` of the page.
        requests: In all.
        clients: Threads that share them.

    Returns:
        Status to number of answers; 0: a connection that ended without one.
    """
    counts, lock = Counter[int](), threading.Lock()

    def ask(first: int) -> None:
        for number in range(first, requests, clients):
            status = _status(address, *ASKED[number % len(ASKED)])
            with lock:
                counts[status] += 1

    threads = [threading.Thread(target=ask, args=(first,)) for first in range(clients)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    return counts


def _status(address: str, method: str, path: str, body: bytes) -> int:
    connection = HTTPConnection(address, timeout=PATIENCE_S)
    try:
        connection.request(method, path, body)
        with connection.getresponse() as reply:
            reply.read()
            return reply.status
    except (OSError, HTTPException):
        return 0
    finally:
        connection.close()


def _until_answered(pages: AskedPages) -> float:
    """Return when the ranking is shown again, by the monotonic clock.

    Raises:
        AssertionError: If it is not within a minute.
    """
    end_s = time.monotonic() + 60.0
    while _status(pages.page.removeprefix("http://"), "GET", "/", b"") != 200:
        assert time.monotonic() < end_s, "the page does not answer after the flood"
        time.sleep(0.1)
    return time.monotonic()


def main() -> None:
    """Flood, and print the figures as JSON."""
    asked = argparse.ArgumentParser(prog="python -m tests.integration.http_flood")
    asked.add_argument("--requests", type=int, default=10_000)
    asked.add_argument("--clients", type=int, default=16)
    asked.add_argument("--rate", type=int, default=100, help="as the setting http_rate")
    how = asked.parse_args()
    with tempfile.TemporaryDirectory(prefix="flooded-") as folder:
        found = flood(Path(folder), requests=how.requests, clients=how.clients, rate=how.rate)
    sys.stdout.write(json.dumps(asdict(found)) + "\n")


if __name__ == "__main__":
    main()
