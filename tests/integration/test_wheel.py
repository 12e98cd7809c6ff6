"""The built wheel, installed: the command, the client, and the review page with its files."""

import re
import subprocess
from pathlib import Path

import httpx
import pytest

from tests.free_ports import free_port
from tests.integration.installed_wheel import CLEAN, InstalledWheel, built_wheel
from tests.integration.running import until
from tests.unit.service.mined_state import mined_state

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built_wheel(tmp_path_factory.mktemp("wheel"))


def test_the_base_install_has_the_command_and_the_client(wheel: Path, tmp_path: Path) -> None:
    installed = InstalledWheel(tmp_path / "venv", wheel)
    code = """
import importlib.util, sys
import service
from service.client import Counterpoint, watch_scenes
assert "venv" in service.__file__, service.__file__
for name in ("torch", "fastapi", "sklearn", "mcap", "pandas"):
    assert importlib.util.find_spec(name) is None, name
print(Counterpoint("http://127.0.0.1:8087").client.overlay_place("a/lidar/1"))
"""
    assert installed.run("-c", code, cwd=tmp_path).strip() == (
        "http://127.0.0.1:8087/api/v1/scenes/a%2Flidar%2F1/overlay"
    )
    mined_state(tmp_path / "state")
    for arguments, words in (
        (["--help"], "review"),
        (["--version"], "0.1.0"),
        (["top", "--json", "--state", str(tmp_path / "state")], "car-7/a"),
    ):
        done = ended([str(installed.counterpoint), *arguments], tmp_path)
        assert (done.returncode, words in done.stdout) == (0, True), done.stderr
    asked = [str(installed.counterpoint), "review", "--state", str(tmp_path / "state")]
    refused = ended(asked, tmp_path)
    assert refused.returncode == 1
    assert "pip install 'counterpoint[review]'" in refused.stderr


def test_the_review_page_of_the_wheel_has_its_files_and_its_api(
    wheel: Path, tmp_path: Path
) -> None:
    installed = InstalledWheel(tmp_path / "venv", wheel, "review")
    mined_state(tmp_path / "state")
    url = f"http://127.0.0.1:{free_port()}"
    command = [str(installed.counterpoint), "review", "--state", str(tmp_path / "state")]
    with subprocess.Popen(
        [*command, "--listen", url.removeprefix("http://")], cwd=tmp_path, env=CLEAN
    ) as page:
        try:
            until(lambda: answers(url), "the page answers")
            text = httpx.get(url).text
            linked = set(re.findall(r'(?:src|href)="(/static/[^"]+)"', text))
            assert len(linked) > 3
            for path in (*linked, "/static/api.css", "/api/v1/", "/api/v1/openapi.json"):
                assert httpx.get(url + path).status_code == 200, path
            code = (
                "from service.client import Counterpoint\n"
                f"rows = Counterpoint({url!r}).scenes(min_score=0.3)\n"
                "print(len(rows), rows[0].vehicle)"
            )
            count, vehicle = installed.run("-c", code, cwd=tmp_path).split()
            assert (int(count) > 3, vehicle) == (True, "bus-7")
        finally:
            page.terminate()
            assert page.wait(30) == 0


def ended(command: list[str], folder: Path) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(command, cwd=folder, env=CLEAN, capture_output=True, text=True)


def answers(url: str) -> bool:
    try:
        return httpx.get(url).status_code == 200
    except httpx.TransportError:
        return False
