"""`counterpoint review` as a process: killed between verdicts, restarted, ended by its parent."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from service.cli.review import review_process
from tests.free_ports import free_port
from tests.integration.judged_through_kills import judge_through_kills
from tests.integration.running import until
from tests.unit.service.mined_state import mined_state

pytestmark = pytest.mark.integration

NUMBER = 40


@pytest.fixture
def state(tmp_path: Path) -> Path:
    mined_state(tmp_path / "state")
    return tmp_path / "state"


def answers(url: str) -> bool:
    try:
        return httpx.get(url).status_code == 200
    except httpx.TransportError:
        return False


@contextmanager
def page(state: Path, port: int) -> Iterator[subprocess.Popen[bytes]]:
    """Run the page until the end of the block, or until it was killed in it."""
    command = [sys.executable, "-m", "service.cli", "review", "--state", str(state)]
    with subprocess.Popen([*command, "--listen", f"127.0.0.1:{port}"]) as process:
        try:
            until(lambda: answers(f"http://127.0.0.1:{port}/"), "the page answers")
            yield process
        finally:
            process.terminate()


def token_of(client: httpx.Client) -> str:
    found = re.search(r'data-token="([0-9a-f]+)"', client.get("/").text)
    assert found is not None
    return found[1]


def test_a_page_that_is_killed_loses_no_verdict_and_an_open_tab_goes_on(state: Path) -> None:
    port = free_port()
    tab = httpx.Client(base_url=f"http://127.0.0.1:{port}", headers={"accept": "application/json"})
    with tab:
        with page(state, port) as process:
            token = token_of(tab)
            assert tab.post("/reviewer", data={"token": token, "name": "Ada"}).status_code == 303
            rows = tab.get("/data/scenes?most=200").json()["rows"]
            verdicts = [
                {"token": token, "scene_id": row["scene_id"], "verdict": verdict, "key": key}
                for i in range(NUMBER)
                for row in (rows[i % len(rows)],)
                for verdict, key in ((("supervised", "neither")[i % 2], f"tab-{i}"),)
            ]
            for verdict in verdicts[: NUMBER // 2]:
                assert tab.post("/verdict", data=verdict).status_code == 200
            process.send_signal(signal.SIGKILL)
            process.wait()
        with pytest.raises(httpx.TransportError):
            tab.post("/verdict", data=verdicts[NUMBER // 2])
        with page(state, port) as process:
            for verdict in verdicts[NUMBER // 2 - 3 :]:  # a tab sends again what it is unsure of
                assert tab.post("/verdict", data=verdict).status_code == 200
            listed = tab.get("/agreement", headers={"accept": "text/html"}).text
            process.terminate()
            assert process.wait(30) == 0
    assert f'<td class="number soft">{NUMBER}</td>' in listed
    assert f'<td class="number soft">{NUMBER + 1}</td>' not in listed, "nothing is stored twice"


def test_the_page_of_a_run_ends_with_it(state: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = free_port()
    monkeypatch.setenv("COUNTERPOINT_REVIEW_LISTEN", f"127.0.0.1:{port}")
    with review_process({"state": state, "config": None}):
        until(lambda: answers(f"http://127.0.0.1:{port}/"), "the page answers")
    assert not answers(f"http://127.0.0.1:{port}/")


def test_two_reviewers_lose_and_double_nothing_while_every_part_is_killed(tmp_path: Path) -> None:
    counts = judge_through_kills(tmp_path, verdicts=200, kills=3)
    assert counts["sent again"] > 0, "no kill hit a verdict"
