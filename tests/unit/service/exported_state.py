"""A state folder with the scenes of the export world, so that its exports can be imported."""

from pathlib import Path

from schemas.canonical import sha256
from schemas.overlay import overlay_key
from schemas.score import SceneScore
from schemas.transport.overlay_codec import encode_overlay
from schemas.transport.wire import encode_scene_score
from service.store.engine import open_store
from tests.contracts.ledger_world import World, plan_of, shard_commit, shard_of
from tests.export_world import overlay, record


def mined_by_p1(score: SceneScore) -> SceneScore:
    producers = score.producers.model_copy(update={"pipeline_version": "p1"})
    return score.model_copy(update={"producers": producers})


def state_of_the_world(folder: Path) -> Path:
    """Make a state folder with the scenes of the export world."""
    folder.mkdir()
    store = open_store(folder)
    scores = [mined_by_p1(record(number)) for number in range(2)]
    world = World.on(store)
    world.listed(scores[0].log_id)
    lease = world.plan_lease()
    log_id, topic = lease.recording.log_id, scores[0].lidar_topic
    shards = (shard_of(log_id, 0, of=1, topic=topic, cells=36_000),)
    plan = plan_of(log_id, shards=1).model_copy(update={"shards": shards})
    assert world.commit_plan(lease, plan=plan).ok
    records = {sha256(each): each for each in map(encode_scene_score, scores)}
    assert world.ledger.commit(shard_commit(world.mine_lease(), records), records).ok
    store.close()
    for score in scores:
        key = overlay_key(
            log_id=score.log_id,
            scene_id=score.scene_id,
            pipeline_version=score.producers.pipeline_version,
            sha256=sha256(encode_scene_score(score)),
        )
        path = folder / "artifacts" / key
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encode_overlay(overlay(score)))
    return folder
