import json
from pathlib import Path

import pytest
from pydantic import ValidationError

from schemas.contradiction import ContradictionKind, SceneState
from schemas.frame import OdometryState
from schemas.score import SceneScore
from schemas.transport.wire import decode, encode_scene_score, is_of_version_1

GOLDEN_V1 = Path(__file__).with_name("golden_scene_score.v1.json")
GOLDEN_V2 = Path(__file__).with_name("golden_scene_score.v2.json")


def test_a_record_of_version_1_is_read_as_version_2_with_its_old_sentences() -> None:
    written = json.loads(GOLDEN_V1.read_bytes())
    record = decode(SceneScore, GOLDEN_V1.read_bytes())
    assert (record.schema_version, record.sentences_version) == (2, 1)
    assert [reason.headline for reason in record.reasons] == written["reasons"]
    assert [reason.track_id for reason in record.reasons] == [0, 1, None]
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


def test_no_number_of_version_1_is_lost_or_changed() -> None:
    written = json.loads(GOLDEN_V1.read_bytes())
    written["tracks"][0]["attribution"] = {
        **{"wrong": "supervised", "supervised": 0.9, "selfsupervised": 0.1, "both": 0.0},
        **{"neither": 0.0, "because": ["the witness sees it move"], "against": ["far"]},
        "also": ["thin"],
    }
    again = json.loads(encode_scene_score(decode(SceneScore, json.dumps(written).encode())))
    attribution = again["tracks"][0]["attribution"]
    assert attribution["supporting"] == ["the witness sees it move"]
    assert (attribution["opposing"], attribution["neutral"]) == (["far"], ["thin"])
    for old, new in (("because", "supporting"), ("against", "opposing"), ("also", "neutral")):
        attribution[old] = attribution.pop(new)
    changed = {"reasons", "schema_version", "sentences_version"}
    assert {name: value for name, value in again.items() if name not in changed} == {
        name: value for name, value in written.items() if name not in changed
    }


def test_a_record_of_version_2_is_still_the_same_bytes() -> None:
    golden = GOLDEN_V2.read_bytes().rstrip(b"\n")
    record = decode(SceneScore, golden)
    assert encode_scene_score(record) == golden
    assert record.sentences_version == 2
    assert record.reasons[0].text == (
        "supervised calls car static, but it moves at 10.0 m/s, 20 m behind, for 2.0 s: "
        "supervised wrong, 79 %; for: straight displacement; against: long range"
    )


@pytest.mark.parametrize(("file", "is_old"), [("v1", True), ("v2", False)])
def test_the_version_of_an_encoded_record_is_known_without_decoding_it(
    file: str, *, is_old: bool
) -> None:
    golden = GOLDEN_V1.with_name(f"golden_scene_score.{file}.json").read_bytes()
    assert is_of_version_1(golden) is is_old


@pytest.mark.parametrize("golden", [GOLDEN_V1, GOLDEN_V2], ids=["version 1", "version 2"])
@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"schema_version": 3}, id="a later version"),
        pytest.param({"mined_at": "2026-11-21"}, id="a time of processing"),
        pytest.param({"score": 1.5}, id="a score above one"),
        pytest.param({"frames": 0}, id="a scene without frames"),
        pytest.param({"start_ns": -1}, id="before the epoch"),
    ],
)
def test_what_is_no_record_is_refused(golden: Path, change: dict[str, object]) -> None:
    record = json.loads(golden.read_bytes()) | change
    with pytest.raises(ValidationError):
        decode(SceneScore, json.dumps(record).encode())
