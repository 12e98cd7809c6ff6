"""A review page with its REST API, and the pages of a service, as processes that are asked."""

import re
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import requests

from tests.free_ports import free_endpoint, free_port
from tests.integration.daemons import Daemon
from tests.unit.service.mined_state import mined_state

PATIENCE_S: Final = 20.0
"""For an answer; a request that takes longer hangs."""

STATUS: Final = re.compile(rb"HTTP/1\.[01] (\d{3}) ")

BUSY: Final = 503
"""Status of a refusal that may pass."""


@dataclass(slots=True)
class HttpReport:
    """Counts of requests by their end.

    Attributes:
        statuses: Number of answers by target and status.
        failures: What went wrong, with the first requests that it went wrong with.
        failed: Number of requests that it went wrong with.
        slowest_s: Longest wait for an answer, seconds.
        slowest: Its request.
        peak_mb: Most memory by process, megabytes.
        deaths: Number of processes that ended by themselves.
    """

    statuses: dict[str, Counter[int]] = field(default_factory=dict)
    failures: dict[str, list[str]] = field(default_factory=dict)
    failed: int = 0
    slowest_s: float = 0.0
    slowest: str = ""
    peak_mb: dict[str, int] = field(default_factory=dict)
    deaths: int = 0

    @property
    def count(self) -> int:
        """Number of requests."""
        return sum(counts.total() for counts in self.statuses.values())

    def fail(self, what: str, request: str) -> None:
        """Note a failure; `what` names no value, so that equal ones are counted together."""
        self.failed += 1
        found = self.failures.setdefault(what, [])
        if len(found) < 3:
            found.append(request)

    def ask(
        self, target: str, request: str, send: Callable[[], requests.Response]
    ) -> requests.Response | None:
        """Send a request and note its end; None: there was no answer."""
        began_s = time.monotonic()
        try:
            answer = send()
        except requests.RequestException as error:
            self.statuses.setdefault(target, Counter())[0] += 1
            self.fail(f"{target}: no answer: {type(error).__name__}", request)
            return None
        seconds = time.monotonic() - began_s
        self.statuses.setdefault(target, Counter())[answer.status_code] += 1
        if seconds > self.slowest_s:
            self.slowest_s, self.slowest = seconds, request
        if answer.status_code >= 500 and answer.status_code != BUSY:
            self.fail(f"{target}: status {answer.status_code}: {answer.text[:200]}", request)
        return answer

    def ask_raw(self, target: str, port: int, sent: bytes) -> None:
        """Send bytes to a port of the loopback, and note the status of what comes back.

        A request that is not HTTP may be ended without an answer, which is counted as status 0.
        """
        began_s, received = time.monotonic(), b""
        try:
            with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as connection:
                connection.sendall(sent)
                while data := connection.recv(1 << 16):
                    received += data
        except TimeoutError:
            self.fail(f"{target}: no end within {PATIENCE_S:g} s", repr(sent[:300]))
        except ConnectionError:  # it hears no more than the bounds of a request
            pass
        found = STATUS.match(received)
        status = int(found[1]) if found else 0
        self.statuses.setdefault(target, Counter())[status] += 1
        seconds = time.monotonic() - began_s
        if seconds > self.slowest_s:
            self.slowest_s, self.slowest = seconds, repr(sent[:200])
        if status >= 500 and status not in (BUSY, 501):
            self.fail(f"{target}: status {status}: {received[-200:]!r}", repr(sent[:300]))

    def lines(self) -> Iterator[str]:
        """Tell it to a person."""
        for target, counts in sorted(self.statuses.items()):
            found = "  ".join(f"{status}: {count}" for status, count in sorted(counts.items()))
            yield f"{target:44s} {counts.total():6d}   {found}"
        yield f"requests: {self.count}"
        yield f"slowest answer {self.slowest_s:.2f} s: {self.slowest[:200]}"
        yield "peak memory: " + ", ".join(f"{name} {mb} MB" for name, mb in self.peak_mb.items())
        yield f"processes that ended: {self.deaths}"
        yield f"failures: {self.failed} in {len(self.failures)} places"
        for what, of_it in self.failures.items():
            yield f"  {what}"
            yield f"        first: {of_it[0][:500]}"


class AskedPages:
    """The processes, and the addresses of their pages.

    Attributes:
        page: Address of the review page.
        service: Address of the pages of the service.
        service_port: Their port.
        report: Filled by those who ask.
    """

    def __init__(self, folder: Path, *, rate: int = 0) -> None:
        state, logs = folder / "page", folder / "logs"
        mined_state(state)
        logs.mkdir()
        (logs / "a.mcap").write_bytes(b"never opened")
        port, service_port, endpoint = free_port(), free_port(), free_endpoint()
        self.page, self.service = f"http://127.0.0.1:{port}", f"http://127.0.0.1:{service_port}"
        self.service_port = service_port
        self.report = HttpReport()
        listen, at = f"127.0.0.1:{port}", ("--connect", endpoint)
        serve = ("service", "--bucket", str(logs), "--state", str(folder / "state"), *at)
        shown = {"COUNTERPOINT_HTTP_LISTEN": f"127.0.0.1:{service_port}"}
        limited = {"COUNTERPOINT_HTTP_RATE": str(rate)}
        self._daemons = (
            Daemon(folder, "router", "router", "--listen", endpoint),
            Daemon(folder, "service", *serve, env=shown),
            Daemon(
                folder, "page", "review", "--state", str(state), "--listen", listen, env=limited
            ),
        )

    def start(self) -> None:
        """Start all, and wait for their pages."""
        for daemon in self._daemons:
            daemon.start()
        end_s = time.monotonic() + 120
        for url in (f"{self.page}/api/v1/openapi.json", f"{self.service}/readyz"):
            while True:
                try:
                    if requests.get(url, timeout=PATIENCE_S).status_code == 200:
                        break
                except requests.RequestException:
                    pass
                words = "\n".join(daemon.words() for daemon in self._daemons)
                assert time.monotonic() < end_s, f"{url} does not answer\n{words}"
                time.sleep(0.1)

    def look(self) -> None:
        """Note memory, and processes that have ended."""
        for daemon in self._daemons[1:]:
            if not daemon.is_running():
                self.report.deaths += 1
                self.report.fail(f"{daemon.name} ended", daemon.words())
                daemon.start()
                continue
            mb = _peak_mb(daemon.pid)
            self.report.peak_mb[daemon.name] = max(mb, self.report.peak_mb.get(daemon.name, 0))

    def end(self) -> None:
        """End all."""
        for daemon in self._daemons:
            daemon.end()


@contextmanager
def asked_pages(folder: Path, *, rate: int = 0) -> Iterator[AskedPages]:
    """Start the processes in a folder, and end them.

    Args:
        folder: For states and logs.
        rate: Requests a second that one client may send to the review page; 0: no limit.
    """
    pages = AskedPages(folder, rate=rate)
    try:
        pages.start()
        pages.look()
        yield pages
        pages.look()
    finally:
        pages.end()


def _peak_mb(pid: int) -> int:
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines()
    (peak,) = (line for line in lines if line.startswith("VmHWM"))
    return int(peak.split()[1]) // 1024
