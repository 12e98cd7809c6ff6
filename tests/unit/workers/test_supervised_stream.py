from pathlib import Path

import numpy as np
import pytest
import torch

from schemas.frame import PosedFrame
from schemas.labels import FrameLabels, MotionLabel
from tests.factories import scattered
from tests.pandaset_clouds import read_clouds
from workers.checkpoints.errors import WeightsUnusableError
from workers.lab.datasets.classes import CLASSES
from workers.lidar.range_image import SensorProfile
from workers.supervised.classes import ClassMeaning
from workers.supervised.lmnet import MOTION_CLASSES
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.weights import (
    LoadedWeights,
    WeightsCard,
    load_weights,
    save_weights,
)

PROFILE = SensorProfile(name="test", rows=16, columns=64, fov_up_deg=10, fov_down_deg=-20)
SEMANTIC = WeightsCard(
    network="salsanext",
    classes=(
        ClassMeaning(name="unlabeled"),
        ClassMeaning(name="car", movable=True),
        ClassMeaning(name="house"),
    ),
    width=4,
    profile=PROFILE,
    attribution="made in a test",
    data_license="CC0",
    training={},
)
MOTION = SEMANTIC.model_copy(
    update={
        "network": "lmnet",
        "classes": tuple(ClassMeaning(name=name) for name in MOTION_CLASSES),
        "residual": ResidualSettings(ages_s=(0.1, 0.2)),
    }
)


def _loaded(folder: Path, card: WeightsCard, *, always: int | None = None) -> LoadedWeights:
    """Weights with random parameters; `always` makes one class win everywhere."""
    torch.manual_seed(4)
    net = card.build()
    if always is not None:
        state = net.state_dict()
        state["logits.weight"] *= 0
        state["logits.bias"] = torch.eye(len(card.classes))[always] * 5
        net.load_state_dict(state)
    path = folder / f"{card.network}.safetensors"
    save_weights(path, net, card)
    return load_weights(path)


def _stream(semantic: LoadedWeights, motion: LoadedWeights) -> RangeImageStream:
    return RangeImageStream(semantic, motion, name="salsanext-lmnet")


def _same(one: FrameLabels, other: FrameLabels) -> bool:
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("labels", "confidence", "class_id")
    )


def test_every_point_of_every_frame_gets_one_answer(tmp_path: Path) -> None:
    stream = _stream(_loaded(tmp_path, SEMANTIC), _loaded(tmp_path, MOTION))
    frames = scattered(3)
    answers = list(stream(frames))
    assert len(answers) == 3
    for posed, answer in zip(frames, answers, strict=True):
        assert len(answer.labels) == len(posed.frame)
        assert answer.class_id is not None
        seen = posed.frame.valid_mask & (answer.class_id >= 0)
        assert seen.sum() > 500
        assert (answer.labels[~posed.frame.valid_mask] == MotionLabel.UNKNOWN).all()
        assert (answer.class_id[~posed.frame.valid_mask] == -1).all()
        assert (answer.class_id != 0).all()
        assert (answer.confidence[answer.labels == MotionLabel.UNKNOWN] == 0).all()
        assert stream.class_names == ("unlabeled", "car", "house")


def test_the_same_frames_give_the_same_bytes_again(tmp_path: Path) -> None:
    stream = _stream(_loaded(tmp_path, SEMANTIC), _loaded(tmp_path, MOTION))
    frames = scattered(3)
    for one, other in zip(stream(frames), list(stream(frames)), strict=True):
        assert _same(one, other)


def test_a_frame_is_answered_before_the_next_one_is_read(tmp_path: Path) -> None:
    stream = _stream(_loaded(tmp_path, SEMANTIC), _loaded(tmp_path, MOTION))
    source = iter(scattered(2))
    answers = stream(source)
    next(answers)
    assert len(list(source)) == 1


def test_cars_are_unknown_until_there_is_a_past_and_again_after_the_pose_was_lost(
    tmp_path: Path,
) -> None:
    stream = _stream(_loaded(tmp_path, SEMANTIC, always=1), _loaded(tmp_path, MOTION, always=2))
    frames = scattered(4, lost=(2,))
    first, second, lost, after = (
        set(answer.labels[posed.frame.valid_mask & (answer.confidence > 0)].tolist())
        for posed, answer in zip(frames, stream(frames), strict=True)
    )
    assert first == set()
    assert second == {MotionLabel.DYNAMIC}
    assert lost == set()
    assert after == {MotionLabel.DYNAMIC}


def test_houses_are_static_from_the_first_frame_on(tmp_path: Path) -> None:
    stream = _stream(_loaded(tmp_path, SEMANTIC, always=2), _loaded(tmp_path, MOTION, always=2))
    frames = scattered(2)
    for posed, answer in zip(frames, stream(frames), strict=True):
        judged = posed.frame.valid_mask & (answer.labels != MotionLabel.UNKNOWN)
        assert judged.sum() > 500
        assert (answer.labels[judged] == MotionLabel.STATIC).all()
        assert (answer.confidence[judged] > 0.9).all()


def test_the_version_follows_the_weights(tmp_path: Path) -> None:
    semantic, motion = _loaded(tmp_path, SEMANTIC), _loaded(tmp_path, MOTION)
    version = _stream(semantic, motion).version
    assert version == _stream(semantic, motion).version
    assert version.startswith("salsanext-lmnet@")
    assert _stream(_loaded(tmp_path, SEMANTIC, always=1), motion).version != version


def test_weights_that_do_not_belong_together_are_refused(tmp_path: Path) -> None:
    semantic, motion = _loaded(tmp_path, SEMANTIC), _loaded(tmp_path, MOTION)
    with pytest.raises(WeightsUnusableError, match="no class of the motion network"):
        _stream(motion, semantic)
    with pytest.raises(WeightsUnusableError, match="needs a semantic or a motion network"):
        RangeImageStream(None, None, name="nothing")
    for name, card in (("salsanext", MOTION), ("lmnet", SEMANTIC)):
        save_weights(tmp_path / "swapped" / f"{name}.safetensors", card.build(), card)
    with pytest.raises(WeightsUnusableError, match="got lmnet and salsanext"):
        RangeImageStream.salsanext_lmnet(tmp_path / "swapped")
    other = MOTION.model_copy(
        update={
            "profile": SensorProfile(
                name="other", rows=32, columns=64, fov_up_deg=10, fov_down_deg=-20
            )
        }
    )
    with pytest.raises(WeightsUnusableError, match="different range images"):
        _stream(semantic, _loaded(tmp_path, other))


def test_each_network_sees_the_frame_as_its_own_training_normalised_it(tmp_path: Path) -> None:
    semantic = _loaded(tmp_path, SEMANTIC)
    elsewhere = PROFILE.__class__(**{**vars(PROFILE), "name": "other", "means": (9.0,) * 5})
    other = _loaded(tmp_path, MOTION.model_copy(update={"profile": elsewhere}))
    same = _loaded(tmp_path, MOTION)
    frames = scattered(2)
    one, two = (list(_stream(semantic, motion)(frames))[-1] for motion in (same, other))
    assert one.class_id is not None
    assert two.class_id is not None
    assert np.array_equal(one.class_id, two.class_id)
    assert not np.array_equal(one.confidence, two.confidence)


def test_the_shipped_weights_are_small_and_say_where_they_come_from() -> None:
    folder = Path(__file__).parents[3] / "workers" / "supervised" / "weights"
    assert sum(path.stat().st_size for path in folder.iterdir()) < 4_000_000
    stream = RangeImageStream.salsanext_lmnet(SHIPPED)
    assert {"car", "pedestrian", "building"} <= set(stream.class_names)
    for name in ("salsanext", "lmnet"):
        card = load_weights(folder / f"{name}.safetensors").card
        assert "PandaSet by Hesai and Scale AI" in card.attribution
        assert "CC BY 4.0" in card.data_license
    assert "PandaSet by Hesai and Scale AI" in (folder / "MODEL_CARD.md").read_text()


@pytest.mark.reference
def test_the_shipped_weights_fit_the_scene_they_were_made_from(reference: Path) -> None:
    """In-scene fit on frames never learnt from: a floor against broken weights, no more."""
    name = Path("pandaset", "panda-01", "2019-05-11", "pandaset-002")
    log = reference / "data" / "logs" / name.with_suffix(".mcap")
    clouds = list(read_clouds(log, reference / "data" / "truth" / name, range(40, 50)))
    stream = RangeImageStream.salsanext_lmnet(SHIPPED)
    movable_classes = [
        index
        for index, (_, movable) in enumerate(CLASSES)
        if movable and stream.class_names[index] == CLASSES[index][0]
    ]
    movable_hits, dynamic_hits = np.zeros(2), np.zeros(2)
    for cloud, answer in zip(
        clouds,
        stream([PosedFrame(each.frame, each.world_from_sensor) for each in clouds]),
        strict=True,
    ):
        assert answer.class_id is not None
        labelled = cloud.semantic > 0
        found, true = (np.isin(ids, movable_classes) for ids in (answer.class_id, cloud.semantic))
        movable_hits += ((found & true)[labelled].sum(), (found | true)[labelled].sum())
        known = (cloud.motion > 0) & (answer.labels != MotionLabel.UNKNOWN)
        found, true = answer.labels == MotionLabel.DYNAMIC, cloud.motion == 2
        dynamic_hits += ((found & true)[known].sum(), (found | true)[known].sum())
    assert movable_hits[0] / movable_hits[1] > 0.80
    assert dynamic_hits[0] / dynamic_hits[1] > 0.50
