"""A log of a car with two lidars, mined by real processes: with one of them, and with both."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.factories import street_log
from tests.integration.daemons import QUICK

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

TOP, FRONT = "/lidar/top/points", "/lidar/front/points"


def counterpoint(*argv: str, topics: str) -> subprocess.CompletedProcess[str]:
    """Run the real command with this setting `lidar_topic`."""
    return subprocess.run(
        [sys.executable, "-m", "service.cli.main", *argv],
        env=os.environ | QUICK | {"COUNTERPOINT_LIDAR_TOPIC": topics},
        capture_output=True,
        text=True,
        timeout=500,
    )


def mined(folder: Path, topics: str) -> list[dict[str, Any]]:
    """Mine the bucket once, and return its scenes."""
    state = folder / f"state-{topics.count(',')}"
    where = ("--bucket", str(folder / "logs"), "--state", str(state))
    ran = counterpoint("run", "--once", *where, "--supervised", "recorded", topics=topics)
    assert ran.returncode == 0, ran.stderr
    top = counterpoint("top", "--state", str(state), "--json", topics=topics)
    assert top.returncode == 0, top.stderr
    return [json.loads(line) for line in top.stdout.splitlines()]


def test_both_lidars_are_mined_as_one_and_a_log_without_the_second_is_refused(
    tmp_path: Path,
) -> None:
    street_log(tmp_path / "logs/sim-01/2026-03-02/street.mcap", frames=40, lidars=2)
    one, two = mined(tmp_path, TOP), mined(tmp_path, f"{TOP},{FRONT}")
    assert [each["scene_id"] for each in one] != []
    assert {each["scene_id"] for each in one} == {each["scene_id"] for each in two}

    street_log(tmp_path / "logs/sim-01/2026-03-03/street.mcap", frames=20)
    state = str(tmp_path / "state-1")
    again = counterpoint(
        *("run", "--once", "--bucket", str(tmp_path / "logs"), "--state", state),
        *("--supervised", "recorded"),
        topics=f"{TOP},{FRONT}",
    )
    status = counterpoint("status", "--state", state, topics=f"{TOP},{FRONT}")
    assert again.returncode == 0, again.stderr
    assert "no point clouds on the configured lidar topic" in status.stdout + status.stderr
