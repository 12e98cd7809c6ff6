"""The pages of whole daemons: where they are served, what is on them, and when they cannot be."""

import json
import os
import re
import signal
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from schemas.runtime.http_endpoint import HttpEndpoint
from schemas.transport.bus import router_session
from service.cli import main as command
from tests.free_ports import free_endpoint
from tests.integration.daemons import DEADLINE_S, Daemon

pytestmark = pytest.mark.integration


@contextmanager
def daemon(folder: Path, *arguments: str, listen: str) -> Iterator[Daemon]:
    one = Daemon(folder, arguments[0], *arguments, env={"COUNTERPOINT_HTTP_LISTEN": listen})
    one.start()
    try:
        yield one
    finally:
        one.end()


def url_of(one: Daemon) -> str:
    """Where the daemon says that its pages are."""
    end_s = time.monotonic() + DEADLINE_S
    while (found := re.search(r"metrics at (http://\S+)/metrics", one.said())) is None:
        assert one.is_running(), one.said()
        assert time.monotonic() < end_s, one.said()
        time.sleep(0.05)
    return found[1]


def until(condition: Callable[[], bool], one: Daemon) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert one.is_running(), one.said()
        assert time.monotonic() < end_s, one.said()
        time.sleep(0.05)


def problems(url: str) -> dict[str, str]:
    """What `/readyz` names."""
    try:
        told = json.loads(page(f"{url}/readyz"))
    except urllib.error.HTTPError as refused:
        with refused:
            told = json.loads(refused.read())
    found: dict[str, str] = told["problems"]
    return found


def worker_pids(one: Daemon) -> list[int]:
    """Workers of a `run`, from the kernel's list of its children."""

    def found() -> list[int]:
        threads = Path(f"/proc/{one.pid}/task").iterdir()
        try:
            children = [child for at in threads for child in (at / "children").read_text().split()]
            return [
                int(c) for c in children if "spawn_main" in Path(f"/proc/{c}/cmdline").read_text()
            ]
        except (FileNotFoundError, ProcessLookupError):  # one has just ended: look again
            return []

    until(lambda: bool(found()), one)
    return found()


def page(url: str) -> str:
    with urllib.request.urlopen(url, timeout=30) as answer:  # noqa: S310
        text: str = answer.read().decode()
    return text


def test_run_serves_the_service_and_its_workers_on_one_page(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    arguments = ("--bucket", str(tmp_path / "logs"), "--state", str(tmp_path / "state"))
    with daemon(tmp_path, "run", *arguments, "--workers", "1", listen="127.0.0.1:0") as run:
        url = url_of(run)
        metrics = page(f"{url}/metrics")
        assert "\ncounterpoint_frames_total 0.0\n" in metrics
        assert "\ncounterpoint_worker_processes_wanted 1.0\n" in metrics
        assert page(f"{url}/healthz") == "alive\n"
        (worker,) = worker_pids(run)
        until(lambda: problems(url) == {}, run)
        os.kill(worker, signal.SIGKILL)
        until(lambda: problems(url).get("workers", "").startswith("no worker is "), run)
        assert page(f"{url}/healthz") == "alive\n", "a worker that died is replaced"
        until(lambda: problems(url) == {}, run)
        try:
            checked = subprocess.run(
                ["promtool", "check", "metrics"],
                input=metrics,
                capture_output=True,
                text=True,
                timeout=60,
            )
        except FileNotFoundError:
            pytest.skip("needs promtool, of Debian's package `prometheus`")
        assert (checked.returncode, checked.stdout, checked.stderr) == (0, "", "")
        assert run.stop() == 0, run.said()
    socket.create_server(("127.0.0.1", int(url.rpartition(":")[2]))).close()  # nobody is left on it


def test_a_service_whose_address_is_taken_ends_with_the_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "logs").mkdir()
    endpoint = free_endpoint()
    with HttpEndpoint("127.0.0.1:0", {}) as taken, router_session([endpoint]):
        monkeypatch.setenv("COUNTERPOINT_HTTP_LISTEN", f"127.0.0.1:{taken.port}")
        where = ["--bucket", str(tmp_path / "logs"), "--state", str(tmp_path / "state")]
        assert command.main(["service", *where, "--connect", endpoint]) == 75
    said = capsys.readouterr().err
    assert f"127.0.0.1:{taken.port}" in said
    assert "with the setting http_listen (COUNTERPOINT_HTTP_LISTEN)" in said
