"""Router, service and workers killed in the middle of their work: nothing lost, nothing changed."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas.canonical import sha256
from schemas.transport.bucket import open_bucket
from schemas.transport.keys import DEFAULT_ROOT
from schemas.transport.recordings import group_recordings
from schemas.transport.wire import encode_scene_score
from service.client import watch_scenes
from service.settings.config import load_settings
from tests.factories import missed_and_phantom
from tests.integration.daemons import System
from workers.lab.simulation.output.write import Identity, write_log
from workers.lab.simulation.sensor.lidar import UNEVEN_64, Lidar
from workers.lab.simulation.world.street_builder import build_street
from workers.score import score_recording

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

LOGS, SECONDS, SHARD_S = 2, 10, 2
SHARDS = LOGS * SECONDS // SHARD_S


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bucket of small streets, labelled by a model on the car that errs now and then."""
    folder = tmp_path_factory.mktemp("chaos") / "logs"
    lidar = Lidar(elevation_deg=UNEVEN_64[::2], columns=192)
    for seed in range(LOGS):
        street = build_street(seed, seconds=SECONDS, style="stands")
        write_log(
            folder / f"car-{seed}" / "2026-03-02" / "drive.mcap",
            street,
            lidar=lidar,
            identity=Identity(vehicle=f"car-{seed}"),
            planted=missed_and_phantom(street),
            chunk_bytes=1 << 18,
        )
    return folder


@pytest.fixture
def system(tmp_path: Path, logs: Path) -> Iterator[System]:
    running = System(
        tmp_path, str(logs), "--shard-seconds", str(SHARD_S), "--supervised", "recorded"
    )
    try:
        yield running
    finally:
        running.end()


@pytest.fixture(scope="module")
def undisturbed(logs: Path) -> dict[str, str]:
    """Scene id to digest, from mining that nobody disturbs, without a bus."""
    settings = load_settings(
        bucket=str(logs), grid={"shard_s": SHARD_S}, supervised="recorded"
    ).mining()
    bucket = open_bucket(str(logs))
    scores = [
        score
        for recording in group_recordings(bucket.list())
        for score in score_recording(bucket, recording, settings)
    ]
    assert any(score.tracks for score in scores), "nothing that a kill could change"
    return {score.scene_id: sha256(encode_scene_score(score)) for score in scores}


def test_kills_in_mid_run_change_no_record_and_a_late_client_gets_them_all(
    system: System, undisturbed: dict[str, str]
) -> None:
    assert len(undisturbed) == SHARDS
    system.start()
    _until_done(system, 1)
    system.restart(system.service)
    _until_done(system, 2)
    system.kill_worker()
    _until_done(system, 3)
    system.restart(system.router)
    _until_done(system, 5)
    system.restart(system.router, system.service)
    _until_done(system, 6)
    system.kill_worker()
    system.restart(system.service)
    _until_done(system, 8)
    system.restart(system.router)
    _until_done(system, SHARDS)

    assert {row.scene_id: row.sha256 for row in system.client.top()} == undisturbed
    assert _received_late(system.endpoint, len(undisturbed)) == undisturbed
    assert system.stop() == [0, 0, 0]


def _until_done(system: System, shards: int) -> None:
    system.until(lambda: system.done() >= shards, f"{shards} shards done")


def _received_late(endpoint: str, scenes: int) -> dict[str, str]:
    received: dict[str, str] = {}
    for event in watch_scenes([endpoint], root=DEFAULT_ROOT):
        received[event.scene_id] = event.sha256
        if len(received) == scenes:
            break
    return received
