"""A folder with every odd entry there is, and one healthy log: that log is mined."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from shutil import which

import pytest

from tests.integration.daemons import QUICK
from workers.lab.simulation.output.write import write_log
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar
from workers.lab.simulation.world.street_builder import build_street

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

SMALL = Lidar(elevation_deg=UNEVEN_64[::4], columns=120)
NOBODY = 65_534
HEALTHY = f"car-1/2026-11-23/{'车' * 80}.mcap"
"""Its name takes 245 bytes as it is, and 725 percent-encoded as in the name of an overlay."""

AS_A_USER_WHO_IS_DENIED = (
    *("setpriv", "--bounding-set=-dac_override,-dac_read_search"),
    *("--inh-caps=-all", "--"),
)
"""Root without the right to pass by permissions: what `lost+found` is to anybody else."""


def fill(logs: Path) -> None:
    """Write one healthy log and one entry of each odd kind."""
    healthy = logs / HEALTHY
    healthy.parent.mkdir(parents=True)
    write_log(healthy, build_street(0, seconds=4, style="stands"), lidar=SMALL, chunk_bytes=1 << 16)
    for name in (b"\xff.mcap", b"line\nbreak.mcap", b"tab\t.mcap", b"\x1b]0;title\x07.mcap"):
        (logs / os.fsdecode(name)).write_bytes(b"x")
    (logs / "car-1" / "round").symlink_to(logs)
    (logs / "itself.mcap").symlink_to("itself.mcap")
    (logs / "nothing.mcap").symlink_to("nowhere")
    os.mkfifo(logs / "pipe.mcap")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(logs / "socket.mcap"))
    (logs / "null.mcap").symlink_to("/dev/null")
    (logs / "lost+found").mkdir(mode=0o700)
    os.chown(logs / "lost+found", NOBODY, NOBODY)


@pytest.mark.skipif(
    os.getuid() != 0 or which("setpriv") is None, reason="only root may give rights away"
)
def test_a_folder_with_every_odd_entry_is_mined_past_them(tmp_path: Path) -> None:
    logs, state = tmp_path / "logs", tmp_path / "state"
    fill(logs)
    command = [sys.executable, "-m", "service.cli.main"]
    where = ["--bucket", str(logs), "--state", str(state)]
    done = subprocess.run(
        [*AS_A_USER_WHO_IS_DENIED, *command, "run", "--once", *where, "--supervised", "recorded"],
        env=os.environ | QUICK,
        capture_output=True,
        timeout=500,
    )
    said = done.stderr.decode()
    assert done.returncode == 0, said
    logged = "\n".join(line for line in said.splitlines() if line.startswith("20"))
    for name in (
        *(r"\xff.mcap", r"line\nbreak.mcap", r"tab\t.mcap", r"\x1b]0;title\x07.mcap"),
        *("car-1/round", "itself.mcap", "nothing.mcap", "pipe.mcap", "socket.mcap", "null.mcap"),
        "lost+found",
    ):
        assert logged.count(name) == 1, name
    assert said.splitlines().count("skipped: 8 more entries") == 1, said
    assert b"\x1b]0" not in done.stderr + done.stdout

    top = subprocess.run(
        [*command, "top", "--state", str(state), "--json"],
        env=os.environ | QUICK,
        capture_output=True,
        check=True,
    )
    rows = [json.loads(line) for line in top.stdout.splitlines()]
    assert {row["log_id"] for row in rows} == {HEALTHY.removesuffix(".mcap")}
    assert list((state / "artifacts").rglob("*.overlay"))
