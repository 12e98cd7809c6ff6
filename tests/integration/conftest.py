"""Fixtures of tests with real servers: one store for the whole session, a small fleet to put in."""

import os
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

from schemas.canonical import sha256
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from schemas.transport.wire import encode_scene_score
from service.settings.config import load_settings
from tests.factories import street_log
from tests.integration.object_store import PACKAGES, Ceph, missing_programs
from workers.score import score_recording

VEHICLES: Final = ("car-0", "car-1", "car-2", "car-3", "car-4", "car-5")
SECONDS, SHARD_S = 6, 2
SHARDS: Final = SECONDS // SHARD_S
"""Of each log of the small fleet, with one scene each."""


@dataclass(frozen=True, slots=True)
class Undisturbed:
    """What mining one log gives when nothing goes wrong.

    Attributes:
        records: Scene id to digest of the record.
        bytes_read: What planning and mining read.
    """

    records: dict[str, str]
    bytes_read: int


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the tests of a file in one process, and all that need the store in the same one."""
    uses_store = {item.path for item in items if "ceph" in getattr(item, "fixturenames", ())}
    for item in items:
        group = "ceph" if item.path in uses_store else item.path.stem
        item.add_marker(pytest.mark.xdist_group(group))


@pytest.fixture(scope="session")
def ceph(reference: Path) -> Iterator[Ceph]:
    """A Ceph gateway of this session's own.

    In CI its absence is a failure, elsewhere the test is skipped and says so.
    """
    missing = missing_programs()
    if missing:
        message = (
            f"no Ceph gateway here ({', '.join(missing)} missing): "
            f"apt-get install -y --no-install-recommends {PACKAGES}"
        )
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    with tempfile.TemporaryDirectory(prefix="ceph-") as folder:
        store = Ceph(reference / "servers", Path(folder))
        try:
            store.up()
            yield store
        finally:
            store.down()


@pytest.fixture(scope="session")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of small logs, one of each vehicle, whose scenes contradict."""
    folder = tmp_path_factory.mktemp("fleet")
    for seed, vehicle in enumerate(VEHICLES):
        street_log(
            folder / key_of(vehicle),
            frames=10 * SECONDS,
            seed=seed,
            style="stands",
            vehicle=vehicle,
        )
    return folder


@pytest.fixture(scope="session")
def undisturbed(fleet: Path) -> dict[str, Undisturbed]:
    """Vehicle to what its log gives, mined from the file, without a bus."""
    settings = load_settings(
        bucket=str(fleet), grid={"shard_s": SHARD_S}, supervised="recorded"
    ).mining()
    bucket = open_bucket(str(fleet))
    mined = {}
    for recording in group_recordings(bucket.list()):
        before = bucket.bytes_read
        scores = list(score_recording(bucket, recording, settings))
        assert any(score.tracks for score in scores), "nothing that could come out differently"
        mined[scores[0].vehicle] = Undisturbed(
            {score.scene_id: sha256(encode_scene_score(score)) for score in scores},
            bucket.bytes_read - before,
        )
    return mined


def key_of(vehicle: str) -> str:
    """Return the key of a vehicle's log."""
    return f"{vehicle}/2026-03-02/drive.mcap"
