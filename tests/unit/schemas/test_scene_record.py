import json
from pathlib import Path

import pytest
from pydantic import ValidationError

from schemas.canonical import sha256
from schemas.contradiction import ContradictionKind, SceneState
from schemas.frame import OdometryState
from schemas.score import SceneScore
from schemas.transport.wire import decode, encode_scene_score

GOLDEN_V1 = Path(__file__).with_name("golden_scene_score.v1.json")


def test_a_record_of_version_1_is_still_read_as_it_was_meant() -> None:
    record = decode(SceneScore, GOLDEN_V1.read_bytes())
    assert record.schema_version == 1
    assert record.scene_id == "fleet/car-1/drive/lidar/1700000000000000000"
    assert record.state is SceneState.SCORED
    assert record.odometry.state is OdometryState.DEGRADED
    assert [track.kind for track in record.tracks] == [
        ContradictionKind.ONLY_PREDICTIVE_DYNAMIC,
        ContradictionKind.ONLY_SEMANTIC_DYNAMIC,
    ]
    assert record.tracks[0].strength > record.tracks[1].strength > 0.5
    assert record.tracks[0].strongest.size_m == (3.86, 1.79, 1.48)
    assert record.producers.pipeline_version == "abcdef012345"


def test_a_record_of_version_1_is_still_the_same_bytes() -> None:
    golden = GOLDEN_V1.read_bytes().rstrip(b"\n")
    assert encode_scene_score(decode(SceneScore, golden)) == golden
    assert len(sha256(golden)) == 64


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"schema_version": 2}, id="a later version"),
        pytest.param({"mined_at": "2026-11-21"}, id="a time of processing"),
        pytest.param({"score": 1.5}, id="a score above one"),
        pytest.param({"frames": 0}, id="a scene without frames"),
        pytest.param({"start_ns": -1}, id="before the epoch"),
    ],
)
def test_what_is_no_record_of_version_1_is_refused(change: dict[str, object]) -> None:
    record = json.loads(GOLDEN_V1.read_bytes()) | change
    with pytest.raises(ValidationError):
        decode(SceneScore, json.dumps(record).encode())
