"""After any day that a bucket may have, the daemon knows what a fresh run would find."""

import sys
from pathlib import Path

import pytest

from tests.integration.bucket_day import FolderHand
from tests.integration.day_system import Evening, play

pytestmark = [pytest.mark.integration, pytest.mark.acceptance, pytest.mark.timeout(900)]


def _say(text: str) -> None:
    sys.stderr.write(text + "\n")


def _agrees(evening: Evening) -> None:
    assert evening.top == evening.fresh
    assert evening.watched == {row["scene_id"]: row["sha256"] for row in evening.fresh}
    assert len(evening.top) > 10
    assert any(row["score"] > 0 for row in evening.top), "nothing that a kill could change"


def test_a_day_on_a_folder_ends_as_a_fresh_run_would(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    _agrees(play(tmp_path, str(logs), FolderHand(logs), say=_say))
