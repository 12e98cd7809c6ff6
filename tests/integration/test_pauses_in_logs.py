"""A log with a long pause, mined by real processes: the stretch without a frame is no trouble."""

import os
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.settings.config import load_settings
from service.store.ledger import Ledger
from service.store.opening import open_ledger_store_to_read
from tests.contracts.databases import postgres_server
from tests.integration.daemons import QUICK
from tests.tiny_logs import Recorder, cloud, drive, ring

pytestmark = [pytest.mark.integration, pytest.mark.timeout(300)]

SECONDS, PAUSE_S = 33, (4.0, 29.0)
"""Two pieces of 4 s, and 25 s between them."""

SHARD_S = 4
POINTS = 864
CLASSES = {"counterpoint.classes": {"3": '{"name": "car", "movable": true, "moving": false}'}}


def delay_ns(number: int) -> int:
    """Time from the stamp of a cloud to its recording, 20 to 99 ms: a busy driver's."""
    return (20 + number) * 1_000_000


def labelled_ring(stamp_ns: int) -> bytes:
    """A static ring of points, each of which the model on the car has called a car."""
    rows = np.frombuffer(ring(0)[-POINTS * 16 - 1 : -1], dtype="<f4").reshape(-1, 4)
    labelled = np.hstack([rows, np.full((POINTS, 1), 3, dtype="<f4")])
    return cloud(stamp_ns, labelled.tobytes(), ("x", "y", "z", "intensity", "label"))


def log_with_pause(path: Path) -> None:
    messages = [
        replace(
            said,
            log_time_ns=said.log_time_ns + delay_ns(number),
            data=labelled_ring(said.log_time_ns),
        )
        for number, said in enumerate(drive(SECONDS, silent=[PAUSE_S]))
    ]
    path.parent.mkdir(parents=True)
    path.write_bytes(Recorder(metadata=CLASSES).write(messages))


def mine_once(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    where = ("--bucket", str(folder / "logs"), "--state", str(folder / "state"))
    how = ("--supervised", "recorded", "--shard-seconds", str(SHARD_S), "--workers", "1")
    return subprocess.run(
        [sys.executable, "-m", "service.cli.main", "run", "--once", *where, *how, *options],
        env=os.environ | QUICK,
        capture_output=True,
        text=True,
        timeout=240,
    )


def assert_all_done(folder: Path, database: str = "") -> None:
    settings = load_settings(state=folder / "state", database=database)
    with closing(open_ledger_store_to_read(settings)) as store:
        status = Ledger(store, now_s=lambda: 0.0).status()
        with store.reading() as connection:
            empty = connection.exec_driver_sql("SELECT count(*) FROM shards WHERE frames = 0")
            assert empty.scalar_one() > 0, "no shard was without a frame: this test shows nothing"
    assert status.logs_by_state == {"done": 1}
    assert set(status.shards_by_state) == {"done"}
    assert status.parked == ()
    assert status.frames >= 70


def test_a_log_with_a_long_pause_is_mined_to_the_end(tmp_path: Path) -> None:
    log_with_pause(tmp_path / "logs" / "car-0" / "pause.mcap")
    ran = mine_once(tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert_all_done(tmp_path)


def test_a_log_with_a_long_pause_is_mined_to_the_end_on_postgres(tmp_path: Path) -> None:
    log_with_pause(tmp_path / "logs" / "car-0" / "pause.mcap")
    with postgres_server() as server:
        url = f"{server}/postgres"
        ran = mine_once(tmp_path, "--database", url)
        assert ran.returncode == 0, ran.stderr
        assert_all_done(tmp_path, url)
