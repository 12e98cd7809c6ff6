"""Networks that run over several frames at once label each of them as by itself."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.frame import PosedFrame
from schemas.labels import FrameLabels
from tests.factories import scattered
from tests.pandaset_clouds import read_clouds
from tests.unit.workers.test_sensor_rows import _frame
from tests.unit.workers.test_supervised_stream import MOTION, SEMANTIC, _loaded
from workers.supervised.networks import FRAMES_TOGETHER, RangeImageNetwork, answers_of
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.weights import load_weights


def _labels(
    semantic: RangeImageNetwork,
    motion: RangeImageNetwork,
    frames: Sequence[PosedFrame],
    *,
    together: int,
) -> list[FrameLabels]:
    stream = RangeImageStream(semantic, motion, name="salsanext-lmnet", together=together)
    return list(stream(frames))


def _assert_equal(alone: Sequence[FrameLabels], together: Sequence[FrameLabels]) -> None:
    assert len(alone) == len(together)
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one.labels, other.labels)
        assert one.class_id is not None
        assert other.class_id is not None
        assert np.array_equal(one.class_id, other.class_id)
        assert np.allclose(one.confidence, other.confidence, atol=1e-3)


def test_batches_of_four_frames_and_a_rest_give_the_labels_of_single_frames(
    tmp_path: Path,
) -> None:
    semantic, motion = (_loaded(tmp_path, card) for card in (SEMANTIC, MOTION))
    frames = scattered(10, lost=(6,))
    alone = _labels(semantic, motion, frames, together=1)
    together = _labels(semantic, motion, frames, together=4)
    _assert_equal(alone, together)
    lost_and_first = {together[0].labels.tobytes(), together[6].labels.tobytes()}
    assert len(lost_and_first) == 1
    assert len({labels.labels.tobytes() for labels in together}) == len(frames) - 1


def test_frames_that_wait_for_a_batch_keep_the_layout_that_they_were_projected_with(
    tmp_path: Path,
) -> None:
    fitted = replace(SEMANTIC.profile, rows=64, columns=256, fitted=True)
    semantic, motion = (
        _loaded(tmp_path, card.model_copy(update={"profile": fitted}))
        for card in (SEMANTIC, MOTION)
    )
    beams = np.linspace(10, -25, 32).tolist()
    clouds = [_frame([0.0], steps=16), *(_frame(beams) for _ in range(5))]
    frames = [
        PosedFrame(replace(each, stamp_ns=each.stamp_ns + number * 10**8), np.eye(4))
        for number, each in enumerate(clouds)
    ]
    alone = _labels(semantic, motion, frames, together=1)
    together = _labels(semantic, motion, frames, together=4)
    _assert_equal(alone, together)
    classes = together[1].class_id
    assert classes is not None
    assert (classes != -1).all()


def test_only_networks_that_take_a_batch_get_one(tmp_path: Path) -> None:
    network = _loaded(tmp_path, SEMANTIC)
    sizes: list[int] = []

    class Watched:
        profile, channels, residual = network.profile, network.channels, network.residual
        classes, digest = network.classes, network.digest

        def probabilities(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
            sizes.append(1)
            return network.probabilities(image)

    class Batched(Watched):
        def probabilities_together(self, images: NDArray[np.float32]) -> NDArray[np.float32]:
            sizes.append(len(images))
            return network.probabilities_together(images)

    image = np.random.default_rng(1).normal(size=(5, 16, 64)).astype(np.float32)
    single = answers_of(Watched(), [image, image])
    assert sizes == [1, 1]
    batched = answers_of(Batched(), [image, image])
    assert sizes == [1, 1, 2]
    answers_of(Batched(), [image])
    assert sizes == [1, 1, 2, 1]
    assert np.allclose(single, batched, atol=1e-6)


def test_the_processor_answers_each_frame_before_the_next_one() -> None:
    assert FRAMES_TOGETHER["cpu"] == 1
    assert FRAMES_TOGETHER["cuda"] > 1


@pytest.mark.reference
def test_the_shipped_networks_label_a_real_street_in_batches_as_frame_by_frame(
    reference: Path,
) -> None:
    name = Path("pandaset", "panda-01", "2019-05-11", "pandaset-002")
    log = reference / "data" / "logs" / name.with_suffix(".mcap")
    clouds = read_clouds(log, reference / "data" / "truth" / name, range(40, 46))
    frames = [PosedFrame(each.frame, each.world_from_sensor) for each in clouds]
    semantic, motion = (
        load_weights(SHIPPED / f"{network}.safetensors", folded=True)
        for network in ("salsanext", "lmnet")
    )
    alone = _labels(semantic, motion, frames, together=1)
    _assert_equal(alone, _labels(semantic, motion, frames, together=4))
