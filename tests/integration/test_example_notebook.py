"""The example notebook, executed cell by cell against the page of a state."""

import os
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from tests.example_notebook import executed
from tests.free_ports import free_port
from tests.integration.running import until
from tests.unit.service.mined_state import mined_state

pytestmark = pytest.mark.integration


def answers(url: str) -> bool:
    try:
        return httpx.get(f"{url}/api/v1/about").status_code == 200
    except httpx.TransportError:
        return False


def test_every_cell_runs_against_a_review_page_and_leaves_no_verdict(tmp_path: Path) -> None:
    mined_state(tmp_path / "state")
    url = f"http://127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "service.cli", "review", "--state", str(tmp_path / "state")]
    with subprocess.Popen(
        [*command, "--listen", url.removeprefix("http://")], env=dict(os.environ)
    ) as page:
        try:
            until(lambda: answers(url), "the page answers")
            ran = executed(url, tmp_path)
            verdicts = httpx.get(f"{url}/api/v1/verdicts").json()["rows"]
        finally:
            page.terminate()
    cells = [each for each in ran["cells"] if each["cell_type"] == "code"]
    assert all(each["outputs"] for each in cells[1:])
    assert "car-7/a" in "".join(cells[1]["outputs"][0]["data"]["text/plain"])
    assert "image/png" in cells[3]["outputs"][0]["data"]
    assert "notebook" in "".join(cells[7]["outputs"][0]["data"]["text/plain"])
    assert verdicts == []
