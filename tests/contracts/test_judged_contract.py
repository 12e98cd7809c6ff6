"""Which streams the current scenes compare, as any database tells it."""

import pytest

from schemas.canonical import sha256
from schemas.score import SceneScore
from schemas.transport.wire import decode, encode_scene_score
from service.curation.status import Judged
from tests.contracts.databases import OnPostgres, OnSqlite
from tests.contracts.ledger_world import World, mined, shard_commit
from tests.contracts.store_contract import StoreContract


class JudgedContract(StoreContract):
    def test_without_a_scene_nothing_was_judged(self, world: World) -> None:
        world.listed("a")
        assert world.ledger.status().judged == ()

    def test_scenes_of_two_models_are_counted_apart_most_first(self, world: World) -> None:
        world.listed("a", "b")
        world.mine_all("p1")
        all_scenes = world.ledger.status().scenes
        (before,) = world.ledger.status().judged
        assert before == Judged(supervised="s@1", selfsupervised="r@1", scenes=all_scenes)
        world.plan_all("p2")
        lease = world.mine_lease(version="p2")
        scores = [
            decode(SceneScore, record)
            for record in mined(lease.shard, lease.recording, pipeline_version="p2").values()
        ]
        records = {}
        for score in scores:
            made_by = score.producers.model_copy(update={"supervised": "recorded@2"})
            record = encode_scene_score(score.model_copy(update={"producers": made_by}))
            records[sha256(record)] = record
        assert world.ledger.commit(shard_commit(lease, records), records).ok
        assert world.ledger.status().judged == (
            Judged(supervised="s@1", selfsupervised="r@1", scenes=all_scenes - len(scores)),
            Judged(supervised="recorded@2", selfsupervised="r@1", scenes=len(scores)),
        )


class TestJudgedOnSqlite(OnSqlite, JudgedContract):
    pass


@pytest.mark.integration
class TestJudgedOnPostgres(OnPostgres, JudgedContract):
    pass
