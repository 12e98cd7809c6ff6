"""Data of training: labels that are proved, classes of truth, what is held out."""

import json
from pathlib import Path

import numpy as np
import pytest

from schemas.labels import FrameLabels, MotionLabel
from tests.factories import frame
from tests.unit.workers.test_training import PROFILE, images_of_a_wall
from workers.lab.datasets.classes import ClassTable
from workers.lab.datasets.images import Cloud
from workers.lab.datasets.learnt_clouds import proved_motion
from workers.lab.datasets.learnt_images import LearntImages, runs_of
from workers.lab.evaluation.truth.truth import LogTruth, TruthUnusableError
from workers.lab.training.augment import Sample
from workers.lab.training.data import LearningData, split
from workers.lab.training.published_augmentation import published_augment


def test_only_what_is_proved_is_learnt() -> None:
    dynamic, static, unknown = MotionLabel.DYNAMIC, MotionLabel.STATIC, MotionLabel.UNKNOWN
    labels = FrameLabels(
        labels=np.array([dynamic, dynamic, static, static, static, unknown], np.uint8),
        confidence=np.array([0.95, 0.95, 0.95, 0.9, 0.7, 0], np.float16),
        confirmed=np.array([True, False, False, False, False, False]),
    )
    assert proved_motion(labels).tolist() == [2, 0, 1, 1, 1, 0]


def _of(name: str, frames: int) -> LearntImages:
    return LearntImages(images_of_a_wall(frames), PROFILE, name)


def test_one_log_of_five_is_held_out_and_at_least_one() -> None:
    learnt, judged = split([[_of(str(number), 2)] for number in range(7)])
    assert [each.source for each in judged] == ["4"]
    assert len(learnt) == 6
    _, judged = split([[_of("a", 2)], [], [_of("b", 2)]])
    assert [each.source for each in judged] == ["b"]


def test_of_a_single_log_the_last_fifth_is_held_out() -> None:
    learnt, judged = split([[_of("a", 6), _of("a", 4)]])
    assert [len(each) for each in learnt] == [6, 2]
    assert [len(each) for each in judged] == [2]
    whole = images_of_a_wall(4)
    np.testing.assert_array_equal(judged[0].images.channels, whole.channels[2:])


def test_replays_have_their_share() -> None:
    data = LearningData([_of("a", 4), _of("b", 2)], [], [_of("streets", 3)], proved=True)
    sets = data.training_sets(replay_share=0.4)
    assert [each.weight for each in sets] == pytest.approx([0.4, 0.2, 0.4])
    assert [each.proved for each in sets] == [True, True, False]
    assert [each.weight for each in data.training_sets(replay_share=0.4, replays=False)] == (
        pytest.approx([2 / 3, 1 / 3])
    )


def test_frames_are_compared_up_to_a_lost_pose() -> None:
    cloud = Cloud(frame(np.ones((1, 3))), np.zeros(1, np.uint8), np.zeros(1, np.uint8), np.eye(4))
    given = [cloud, cloud, None, cloud, None, *[cloud] * 61]
    assert [len(each) for each in runs_of(iter(given))] == [2, 60]


def _truth(folder: Path, ids: list[int], listed: list[dict[str, object]]) -> LogTruth:
    log = folder / "log"
    log.mkdir(parents=True)
    np.savez(log / "000000.npz", semantic=np.array(ids, np.uint8))
    (folder / "classes.json").write_text(json.dumps({"classes": listed}))
    from schemas.work import Part, Recording

    part = Part(key="log.mcap", size=1, etag="")
    found = LogTruth.beside(Recording(log_id="log", parts=(part,)), folder)
    assert found is not None
    return found


def test_own_classes_are_those_of_the_folder_and_an_unknown_id_is_refused(tmp_path: Path) -> None:
    listed: list[dict[str, object]] = [
        {"id": 0, "name": "nothing", "semantickitti19": 0},
        {"id": 7, "name": "delivery van", "semantickitti19": 1},
        {"id": 9, "name": "guard rail", "semantickitti19": 14},
    ]
    truth = _truth(tmp_path, [9, 7, 0], listed)
    table = ClassTable.own_of(tmp_path)
    assert [each.name for each in table.meanings] == ["unlabeled", "delivery van", "guard rail"]
    assert [each.movable for each in table.meanings] == [False, True, False]
    points = frame(np.ones((3, 3)))
    assert table.of(truth, points, number=0).tolist() == [2, 1, 0]
    np.savez(tmp_path / "log" / "000000.npz", semantic=np.array([9, 8, 0], np.uint8))
    with pytest.raises(TruthUnusableError, match="class id 8"):
        table.of(truth, points, number=0)
    (tmp_path / "classes.json").unlink()
    with pytest.raises(TruthUnusableError, match=r"classes\.json"):
        ClassTable.own_of(tmp_path)


@pytest.mark.parametrize("seed", range(6))
def test_the_published_augmentation_keeps_labels_with_their_points(seed: int) -> None:
    images = images_of_a_wall()
    residuals = images.residuals[2, 0].astype(np.float32)
    whole = Sample(images.channels[2], residuals, images.seen_mask[2], images.motion[2])
    changed = published_augment(whole, np.random.default_rng(seed), layout=PROFILE)
    assert changed.channels.shape == whole.channels.shape
    near, far = changed.labels == 2, changed.labels == 1
    assert near.any()
    assert np.median(changed.channels[0][near]) < np.median(changed.channels[0][far])
    np.testing.assert_array_equal(changed.residuals, whole.residuals)
