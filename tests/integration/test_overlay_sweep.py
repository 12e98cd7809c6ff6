"""A running service deletes overlays of withdrawn scenes, on a folder and on a real S3 server."""

import os
import re
import urllib.request
from pathlib import Path
from threading import Event

import pytest

from schemas.errors import BucketRefusedError
from schemas.overlay import overlay_key
from schemas.transport.bucket import Bucket
from service.background.overlay_cleanup import OverlaySweep
from service.store.engine import open_store
from service.store.ledger import StoredScene
from tests.contracts.ledger_world import World
from tests.factories import street_log
from tests.free_ports import free_port
from tests.integration.daemons import System
from tests.integration.object_store import OVERLAYS, Ceph

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]


def key_of(scene: StoredScene) -> str:
    return overlay_key(
        log_id=scene.log_id,
        scene_id=scene.scene_id,
        pipeline_version=scene.pipeline_version,
        sha256=scene.sha256,
    )


def test_a_daemon_deletes_the_overlays_of_a_log_that_is_gone_and_no_other(tmp_path: Path) -> None:
    bucket, http = tmp_path / "logs", f"127.0.0.1:{free_port()}"
    for name in ("goes", "stays"):
        street_log(bucket / "car-1" / "today" / f"{name}.mcap", frames=20, vehicle="car-1")
    settings = {
        "COUNTERPOINT_HTTP_LISTEN": http,
        "COUNTERPOINT_LIST_INTERVAL_S": "0.5",
        "COUNTERPOINT_KEEP_WITHDRAWN_DAYS": "0.00002",  # 1.7 s
    }
    system = System(tmp_path, str(bucket), "--supervised", "recorded", env=settings)
    overlays = system.state / "artifacts" / "overlays"

    def logs_with_overlays() -> set[str]:
        # `os.walk` passes over a folder that the service deletes meanwhile; `rglob` raises.
        folders = (Path(folder) for folder, _, files in os.walk(overlays) if files)
        return {folder.relative_to(overlays).parts[3] for folder in folders}

    try:
        system.start()
        system.until(
            lambda: set(system.states().values()) == {"done"} and len(system.states()) == 2,
            "both logs mined",
        )
        assert logs_with_overlays() == {"goes", "stays"}
        logs = sorted(bucket.rglob("*"))
        going = bucket / "car-1" / "today" / "goes.mcap"
        going.unlink()
        system.until(lambda: logs_with_overlays() == {"stays"}, "its overlays are deleted")
        with urllib.request.urlopen(f"http://{http}/metrics", timeout=60) as reply:
            text = reply.read().decode()
        (counted,) = re.findall(r"^counterpoint_overlays_deleted_total (\S+)$", text, re.MULTILINE)
        assert float(counted) > 0
        assert "overlays of withdrawn scenes deleted" in system.service.said()
        assert sorted(bucket.rglob("*")) == [path for path in logs if path != going]
        for row in system.client.top():
            system.client.overlay(row.scene_id)  # what is current has its picture
    finally:
        system.end()


def test_a_daemon_refuses_to_delete_where_logs_lie(tmp_path: Path) -> None:
    settings = {"COUNTERPOINT_KEEP_WITHDRAWN_DAYS": "30"}
    (tmp_path / "state").mkdir()
    system = System(tmp_path, str(tmp_path), env=settings)
    try:
        system.router.start()
        system.service.start()
        system.until(lambda: not system.service.is_running(), "the service ends")
        assert system.service.ended() == 1
        assert "nothing may be deleted where logs lie" in system.service.said()
    finally:
        system.end()


def test_on_s3_only_what_may_go_goes_and_a_refusal_is_said(ceph: Ceph, tmp_path: Path) -> None:
    writer, name = ceph.make_user(), ceph.make_bucket()
    ceph.allow(name, {writer: OVERLAYS})
    artifacts, forbidden = ceph.open(name), ceph.open(name, writer)
    store = open_store(tmp_path)
    world = World.on(store)
    world.listed("a/ä 1", "b")
    world.mine_all()
    scenes = world.ledger.current_scenes()
    for scene in scenes:
        artifacts.put(key_of(scene), b"points")
    artifacts.put("b.mcap", b"a log, by mistake")

    def sweep_by(bucket: Bucket) -> OverlaySweep:
        return OverlaySweep(bucket, world.ledger, keep_s=60.0, log_bucket_url="s3://logs")

    world.listed("b")
    sweep = sweep_by(artifacts)
    sweep.sweep(Event())
    world.clock.now_s += 60
    with pytest.raises(BucketRefusedError, match="denies these credentials writing here"):
        sweep_by(forbidden).sweep(Event())
    assert len(list(artifacts.list())) == len(scenes) + 1
    sweep.sweep(Event())
    left = {key_of(scene) for scene in scenes if scene.log_id == "b"} | {"b.mcap"}
    assert {found.key for found in artifacts.list()} == left
    assert sweep.deleted == len(scenes) - len(left) + 1
    store.close()
