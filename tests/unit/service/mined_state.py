"""A state folder with the mined scenes of one log, and an overlay of each where it belongs."""

from pathlib import Path
from typing import Any

import numpy as np

from schemas.canonical import sha256
from schemas.overlay import Overlay, overlay_key
from schemas.score import SceneScore
from schemas.transport.overlay_codec import encode_overlay
from schemas.transport.wire import encode_scene_score
from schemas.work import NothingToDo, PlanLease
from service.store.engine import Store, open_store
from service.store.ledger import StoredScene
from tests.contracts.ledger_world import World, mined, shard_commit
from tests.contracts.test_listing_contract import commit, scene
from tests.factories import track_at
from tests.overlays import labels_of_points


def small_overlay(scene_id: str) -> Overlay:
    """One frame of three points."""
    return Overlay(
        scene_id=scene_id,
        stamps_ns=np.array([0], np.int64),
        offsets=np.array([0, 3], np.int64),
        points_cm=np.array([[100, 0, 0], [0, 200, 0], [0, 0, 50]], np.int16),
        **labels_of_points(np.zeros(3, np.uint8)),
        ground_mask=np.zeros(3, np.bool_),
        class_id=np.full(3, -1, np.int16),
        class_names=(),
        semantic_confidence=np.full(3, 255, np.uint8),
        predictive_confidence=np.full(3, 255, np.uint8),
        instance_index=np.full(3, -1, np.int32),
        odom_from_sensor=np.eye(4)[None],
        instance_frame=np.zeros(0, np.int32),
        instance_kind=np.zeros(0, np.uint8),
        instance_track=np.zeros(0, np.int32),
        instance_boxes=np.zeros((0, 7), np.float32),
    )


def mined_state(
    folder: Path, *, log_id: str = "car-7/a", store: Store | None = None, **changes: Any
) -> list[Path]:
    """Make a state folder; return the files of its overlays, best scene first.

    Args:
        folder: Of the state.
        log_id: The log.
        store: Database; None: a file in the folder.
        changes: Fields that all its records have otherwise than usual.
    """
    folder.mkdir(parents=True, exist_ok=True)
    store = store or open_store(folder)
    world = World.on(store)
    world.listed(log_id)
    while not isinstance(grant := world.claim(), NothingToDo):
        if isinstance(grant, PlanLease):
            assert world.commit_plan(grant).ok
            continue
        records = {}
        for usual in mined(grant.shard, grant.recording, pipeline_version="p1").values():
            score = SceneScore.model_validate_json(usual).model_copy(update=changes)
            records[sha256(encode_scene_score(score))] = encode_scene_score(score)
        assert world.ledger.commit(shard_commit(grant, records), records).ok
    ranked = world.ledger.ranking()
    scenes = [world.ledger.scene(row.scene_id) for row in ranked]
    store.close()
    return [_written(folder / "artifacts", scene) for scene in scenes if scene is not None]


def _written(artifacts: Path, scene: StoredScene) -> Path:
    key = overlay_key(
        log_id=scene.log_id,
        scene_id=scene.scene_id,
        pipeline_version=scene.pipeline_version,
        sha256=scene.sha256,
    )
    path = artifacts / key
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode_overlay(small_overlay(scene.scene_id)))
    return path


def scenes_at(folder: Path, *ranges_m: float) -> None:
    """Leave a state with scenes of one strong track each, at these ranges, metres, best first."""
    store = open_store(folder)
    commit(
        World.on(store),
        *(
            scene(
                4 * number,
                0.9 - number / 20,
                log_id="car-9/b",
                tracks=(track_at(range_m),),
                reasons=(f"supervised labels car static, {range_m:.0f} m ahead",),
            )
            for number, range_m in enumerate(ranges_m)
        ),
    )
    store.close()
