"""`bench fleet`: workers of the real protocol whose mining is a pause."""

import json
from pathlib import Path

import pytest

from service.cli.main import main

pytestmark = pytest.mark.integration


def test_a_fleet_mines_what_its_pauses_allow(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sizes = ["--workers", "3", "--mine-s", "0.5", "--seconds", "4"]
    assert main(["bench", "fleet", "--folder", str(tmp_path), *sizes, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["workers"] == 3
    assert found["shards"] > 0
    assert 0 < found["efficiency"] <= 1
    assert found["service_end_mb"] > 0
    assert list(tmp_path.iterdir()) == [], "its state is gone"
