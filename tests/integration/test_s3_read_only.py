"""Whoever may only read the log bucket can mine it; overlays go to another bucket."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from schemas.errors import BucketRefusedError
from schemas.transport.overlay_codec import decode_overlay
from schemas.transport.recordings import group_recordings
from tests.integration.conftest import SHARD_S, SHARDS, Undisturbed, key_of
from tests.integration.daemons import QUICK
from tests.integration.object_store import OVERLAYS, READ, Ceph
from workers.worker.store_health import StoreTroubleError, cause_of

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]


def counterpoint(*arguments: str, environment: dict[str, str]) -> str:
    """Run a command to its end and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-m", "service.cli.main", *arguments],
        env=os.environ | QUICK | environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_whole_run_needs_to_read_the_logs_and_to_write_overlays_elsewhere(
    ceph: Ceph, fleet: Path, undisturbed: dict[str, Undisturbed], tmp_path: Path
) -> None:
    user, logs, overlays = ceph.make_user(), ceph.make_bucket(), ceph.make_bucket()
    ceph.allow(logs, {user: READ})
    ceph.allow(overlays, {user: OVERLAYS})
    ceph.open(logs).put(key_of("car-0"), (fleet / key_of("car-0")).read_bytes())
    before = list(ceph.open(logs).list())
    with pytest.raises(BucketRefusedError):
        ceph.open(logs, user).put("a", b"")

    state, environment = str(tmp_path / "state"), ceph.environment(user)
    where = ("--bucket", f"s3://{logs}", "--artifacts", f"s3://{overlays}", "--state", state)
    options = ("--shard-seconds", str(SHARD_S), "--supervised", "recorded")
    counterpoint("run", "--once", *where, *options, environment=environment)
    rows = map(
        json.loads, counterpoint("top", "--state", state, "--json", environment={}).splitlines()
    )

    assert {row["scene_id"]: row["sha256"] for row in rows} == undisturbed["car-0"].records
    assert list(ceph.open(logs).list()) == before
    written = {found.key: found.size for found in ceph.open(overlays).list()}
    kept = [key for key, size in written.items() if key.endswith(".overlay") and size]
    assert len(kept) == SHARDS
    decode_overlay(ceph.open(overlays, user).read_all(kept[0]))  # whose writer owns it
    assert not list((tmp_path / "state").rglob("*.overlay"))


def test_an_op_mask_of_reading_lists_and_reads_and_nothing_else(ceph: Ceph) -> None:
    reader, name = ceph.make_user(op_mask="read"), ceph.make_bucket()
    ceph.open(name).put("a", b"123")
    ceph.allow(name, {reader: ("s3:*",)})
    bucket = ceph.open(name, reader)
    (found,) = bucket.list()
    assert bucket.read_range("a", 1, 2, found.etag) == b"23"
    with pytest.raises(BucketRefusedError, match="denies these credentials writing here"):
        bucket.put("a", b"456")
    assert ceph.open(name).read_all("a") == b"123"


def test_a_bucket_that_may_be_listed_only_is_waited_for(ceph: Ceph) -> None:
    user, logs = ceph.make_user(), ceph.make_bucket()
    owner = ceph.open(logs)
    for name in ("a", "b"):
        owner.put(f"{name}.mcap", b"0123456789")
    ceph.allow(logs, {user: ("s3:ListBucket",)})
    bucket = ceph.open(logs, user)
    (recording, _) = group_recordings(bucket.list())
    with pytest.raises(BucketRefusedError) as caught:
        bucket.read_range("a.mcap", 0, 1, recording.parts[0].etag)
    cause = cause_of(caught.value, bucket, recording, repeated=True)
    assert isinstance(cause, StoreTroubleError)
    with pytest.raises(BucketRefusedError):
        cause.again()
    ceph.allow(logs, {user: READ})
    cause.again()
