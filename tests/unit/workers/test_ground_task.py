"""The task `ground`: its two streams, how they are chosen, and who refuses it."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.canonical import sha256
from schemas.frame import RecordedClass
from schemas.mining import MiningSettings
from schemas.score import AgreementShares, SceneScore
from schemas.task import GROUND, MOTION
from schemas.transport.wire import encode_scene_score
from schemas.work import CommitRequest, ManifestEntry
from service.cli.main import main
from service.store.manifest import verify
from tests import factories
from workers.checkpoints.errors import WeightsUnusableError
from workers.errors import TasksDifferError, UnknownPartError
from workers.lab.evaluation.motion.alternatives import build_streams
from workers.parts.catalogue import parts_of_kind
from workers.parts.part import PartKind
from workers.parts.registry import build_parts, build_selfsupervised, build_supervised
from workers.selfsupervised.ground_stream import GroundStream
from workers.supervised.classes import ClassMeaning, ClassSet
from workers.supervised.ground_classes import GroundFusion, ground_labels_of
from workers.supervised.recorded import Recorded
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.worker.worker_context import build_context

OTHER, ON_GROUND, UNKNOWN = 0, 1, 2
NAMES = ("unlabeled", "Road", "other-ground", "lane marking", "vegetation", "car")


def _network(*names: str) -> ClassSet:
    return ClassSet([ClassMeaning(name=name) for name in names])


def test_names_of_classes_mean_ground_however_they_are_written() -> None:
    assert ground_labels_of(NAMES).tolist() == [UNKNOWN, *[ON_GROUND] * 3, OTHER, OTHER]


def test_a_network_is_as_sure_of_ground_as_of_all_its_ground_classes_together() -> None:
    fusion = GroundFusion(_network("road", "sidewalk", "car"))
    probabilities = np.array([[0.5, 0.1], [0.4, 0.1], [0.1, 0.8]], dtype=np.float32)
    said = fusion.labels(
        judged_mask=np.array([True, True, False]),
        kind=np.array([0, 2, 0], dtype=np.int16),
        motion=None,
        second_share=np.append(fusion.second_share(probabilities, None), np.float32(0)),
    )
    assert said.labels.tolist() == [ON_GROUND, OTHER, UNKNOWN]
    np.testing.assert_allclose(said.confidence, [0.9, 0.8, 0], atol=1e-3)
    assert said.class_id is not None
    assert said.class_id.tolist() == [0, 2, -1]
    assert said.ground_mask is None


def test_a_network_that_knows_no_ground_is_refused() -> None:
    with pytest.raises(WeightsUnusableError, match="is ground: car, pole"):
        GroundFusion(_network("car", "pole"))


def test_recorded_classes_are_ground_by_their_names() -> None:
    classes = {
        number: RecordedClass(name=name, movable=False, moving=False)
        for number, name in enumerate(NAMES)
    }
    ids = [1, 5, 0, 99, 3]
    recorded = factories.recorded(None, class_id=ids, classes=classes)
    frame = factories.frame(np.ones((5, 3)), recorded=recorded)
    (said,) = Recorded(GROUND)([factories.posed(frame)])
    assert said.labels.tolist() == [ON_GROUND, OTHER, UNKNOWN, UNKNOWN, ON_GROUND]
    assert said.confidence.tolist() == [1, 1, 0, 0, 1]
    assert Recorded(GROUND).version != Recorded().version


def _rings(height_m: float) -> NDArray[np.float32]:
    """A road seen by fifty beams, and a wall twelve metres ahead."""
    radius, angle = np.meshgrid(np.geomspace(3, 60, 50), np.radians(np.arange(0, 360, 0.5)))
    noise = np.random.default_rng(1).normal(0, 0.02, radius.shape)
    road = np.stack([radius * np.cos(angle), radius * np.sin(angle), noise - height_m], axis=-1)
    wall = np.stack(np.meshgrid([12.0], np.arange(-4, 4, 0.1), np.arange(-1.0, 2.0, 0.1)), axis=-1)
    return np.concatenate([road.reshape(-1, 3), wall.reshape(-1, 3)]).astype(np.float32)


def test_the_self_supervised_stream_finds_the_road_and_no_wall() -> None:
    points_m = _rings(1.8)
    valid = np.ones(len(points_m), np.bool_)
    valid[::50] = False
    (said,) = GroundStream()([factories.posed(factories.frame(points_m, valid_mask=valid))])
    is_wall = np.arange(len(points_m)) >= len(points_m) - 80 * 30
    assert (said.labels[~valid] == UNKNOWN).all()
    assert (said.labels[valid & ~is_wall] == ON_GROUND).mean() > 0.95
    assert (said.labels[valid & is_wall] == OTHER).mean() > 0.95
    assert (said.confidence[said.labels == UNKNOWN] == 0).all()
    assert (said.confidence[said.labels != UNKNOWN] > 0.5).all()


def test_a_frame_without_points_has_no_ground_and_says_why() -> None:
    (said,) = GroundStream()([factories.posed(factories.frame(np.zeros((0, 3))))])
    assert len(said.labels) == 0
    assert said.health.reason


def without_files(kind: PartKind) -> list[str]:
    """Names of the parts of a kind that need no file of the user's."""
    return [
        part.name
        for part in parts_of_kind(kind)
        if part.name != "own" and (part.ships or not part.networks)
    ]


def test_every_stream_answers_a_task_and_those_of_one_task_can_be_chosen_together() -> None:
    named = {"salsanext:ground", "recorded:ground", "ground"}
    streams = {
        **{name: build_supervised(name) for name in without_files("supervised")},
        **{name: build_selfsupervised(name) for name in without_files("selfsupervised")},
    }
    assert named < set(streams)
    for name, stream in streams.items():
        assert stream.task == (GROUND if name in named else MOTION), name
    parts = build_parts(odometry="kiss-icp", supervised="recorded:ground", selfsupervised="ground")
    assert parts.task == GROUND


def test_streams_of_two_tasks_are_refused_with_both_named() -> None:
    with pytest.raises(TasksDifferError, match=r"task motion, the self-supervised one ground"):
        build_parts(odometry="kiss-icp", supervised="recorded", selfsupervised="ground")


def test_the_weights_that_ship_tell_ground() -> None:
    stream = RangeImageStream.salsanext_ground(SHIPPED)
    assert stream.task == GROUND
    assert "sidewalk" in stream.class_names
    assert stream.version != RangeImageStream.salsanext_lmnet(SHIPPED).version


def test_a_worker_of_a_service_refuses_any_task_but_motion(tmp_path: Path) -> None:
    settings = MiningSettings(
        bucket=tmp_path.as_uri(),
        artifacts=tmp_path.as_uri(),
        supervised="recorded:ground",
        selfsupervised="ground",
    )
    with pytest.raises(UnknownPartError, match="counterpoint score"):
        build_context(settings)


def test_what_judges_motion_refuses_streams_of_another_task() -> None:
    settings = MiningSettings(bucket=".", artifacts=".")
    with pytest.raises(UnknownPartError, match="'ground' has the task ground"):
        build_streams(("registration", "ground"), settings)


def test_a_service_refuses_to_commit_a_scene_of_another_task() -> None:
    shares = AgreementShares(
        both_other=0.9, only_semantic_ground=0.0, only_predictive_ground=0.0, both_ground=0.1
    )
    score = factories.scene_score(
        task="ground", all_points=shares, nonground_points=shares, totals=(), tracks=()
    )
    record = encode_scene_score(score)
    entry = ManifestEntry(scene_id=score.scene_id, sha256=sha256(record))
    request = CommitRequest(
        worker_id="w", lease_id="l", manifest=(entry,), records=(record.decode(),)
    )
    assert "of the task ground" in verify(request, {}).problem


def test_score_mines_ground_on_a_log_and_draws_its_scenes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = factories.street_log(tmp_path / "car" / "day" / "a.mcap", frames=24)
    chosen = ["--supervised", "recorded:ground", "--selfsupervised", "ground"]
    pictures = tmp_path / "pictures"
    assert main(["score", str(log), *chosen, "--json", "--pictures", str(pictures)]) == 0
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert {record["task"] for record in records} == {"ground"}
    assert len(list(pictures.glob("*.png"))) == len(records)
    best = SceneScore.model_validate(max(records, key=lambda record: record["frames"]))
    assert best.all_points["both_ground"] > 0.1
    assert best.all_points["both_other"] > 0.1
    assert {total.kind for total in best.totals} == {
        "only_semantic_ground",
        "only_predictive_ground",
    }
    assert sha256(encode_scene_score(best))
