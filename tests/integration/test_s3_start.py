"""A bucket that cannot be had at the start: every command ends in one sentence and an exit code."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from schemas.transport.bus import router_session
from tests.free_ports import free_endpoint
from tests.integration.daemons import DEADLINE_S, QUICK
from tests.integration.object_store import Ceph

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

TEMPORARY, PERMANENT = 75, 1


def ends_of(commands: Sequence[Sequence[str]], environment: dict[str, str]) -> list[str]:
    """Run commands side by side; of each its exit code and the last thing that it says."""
    running = [
        subprocess.Popen(
            [sys.executable, "-m", "service.cli.main", *command],
            env=os.environ | QUICK | environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for command in commands
    ]
    ends = []
    try:
        for process in running:
            _, said = process.communicate(timeout=DEADLINE_S)
            assert "Traceback" not in said, said
            ends.append(f"{process.returncode}: {said.splitlines()[-1] if said else ''}")
    finally:
        for process in running:
            process.kill()
    return ends


def commands_on(bucket: str, folder: Path, endpoint: str) -> list[list[str]]:
    """All that look into a bucket before anything else."""
    return [
        ["run", "--once", "--bucket", bucket, "--state", str(folder / "once")],
        ["run", "--dry-run", "--bucket", bucket, "--state", str(folder / "dry")],
        ["service", "--bucket", bucket, "--state", str(folder / "s"), "--connect", endpoint],
    ]


def test_a_gateway_that_is_down_at_the_start_ends_it_as_worth_another_try(
    ceph: Ceph, tmp_path: Path
) -> None:
    bucket, endpoint = f"s3://{ceph.make_bucket()}", free_endpoint()
    ceph.kill()
    try:
        with router_session([endpoint]):
            ends = ends_of(commands_on(bucket, tmp_path, endpoint), ceph.environment())
    finally:
        ceph.start()
    sentence = f"the store cannot be reached: connection refused ({bucket})"
    assert ends == [f"{TEMPORARY}: try again later: {sentence}"] * len(ends)


def test_a_bucket_that_does_not_exist_ends_the_start_for_good(ceph: Ceph, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with router_session([endpoint]):
        commands = commands_on("s3://nowhere", tmp_path, endpoint)[1:]  # one `run` is enough
        ends = ends_of(commands, ceph.environment())
    sentence = "there is no such bucket or folder (s3://nowhere)"
    assert ends == [f"{PERMANENT}: error: {sentence}"] * len(ends)
