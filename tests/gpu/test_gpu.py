"""Networks on a GPU of CUDA: the answers of the processor, and every training of the project."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.factories import scattered
from tests.unit.workers import test_flow_training as flow
from tests.unit.workers import test_ground_training as ground
from tests.unit.workers import test_odometry_training as odometry
from tests.unit.workers.test_training import CARD
from tests.unit.workers.test_training_run import SEMANTIC, SETTINGS, _sets
from workers.checkpoints.devices import Device, device_of
from workers.lab.datasets import flow_clouds, ground_clouds, normal_scans
from workers.lab.datasets.frame_files import pairs_of
from workers.lab.training.elevation import train_ground
from workers.lab.training.odometry import train_odometry
from workers.lab.training.run_state import Progress
from workers.lab.training.scene_flow import DEFAULT, train_flow
from workers.lab.training.segmentation import train
from workers.lab.training.settings import TrainingSettings
from workers.paper.point_sets import find_nearest, sample_furthest
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.weights import WeightsCard

pytestmark = pytest.mark.gpu

GPU: Device = "cuda"


def _losses_of_both(
    train_on: Callable[..., Progress], settings: TrainingSettings, out: Path
) -> tuple[list[float], list[float]]:
    """Train on the processor and on the GPU; return the losses of each."""
    one, other = (
        [
            loss
            for _, loss, _ in train_on(
                replace(settings, device=device), out=out / device / "w.safetensors"
            ).curve
        ]
        for device in ("cpu", GPU)
    )
    return one, other


def test_a_gpu_is_chosen_by_itself() -> None:
    assert device_of("auto") == GPU


def test_the_shipped_networks_label_almost_every_point_as_on_the_processor() -> None:
    frames = scattered(20)
    one, other = (
        list(RangeImageStream.salsanext_lmnet(SHIPPED, device=device)(frames))
        for device in ("cpu", GPU)
    )
    same = [float((a.labels == b.labels).mean()) for a, b in zip(one, other, strict=True)]
    assert float(np.mean(same)) > 0.999
    for a, b in zip(one, other, strict=True):
        assert float(np.abs(a.confidence.astype(float) - b.confidence).mean()) < 1e-3


def test_points_are_sampled_and_searched_as_on_the_processor() -> None:
    points = torch.randn(3, 700, 3, generator=torch.Generator().manual_seed(1)) * 10
    assert torch.equal(sample_furthest(points.to(GPU), 300).cpu(), sample_furthest(points, 300))
    squared, index = find_nearest(points.to(GPU), points.to(GPU), 9)
    expected_squared, expected = find_nearest(points, points, 9)
    assert torch.equal(index.cpu(), expected)
    assert torch.allclose(squared.cpu(), expected_squared, atol=1e-5)


@pytest.mark.parametrize(("card", "proved"), [(CARD, False), (SEMANTIC, True)])
def test_a_segmentation_network_begins_with_the_loss_of_the_processor_and_learns(
    tmp_path: Path, card: WeightsCard, proved: bool
) -> None:
    sets = _sets(proved=proved)
    one, other = _losses_of_both(partial(train, sets, {"wall": sets[-1]}, card), SETTINGS, tmp_path)
    assert np.allclose(one[:1], other[:1], rtol=0.3)
    assert np.isfinite(other).all()


def test_flowstep3d_is_trained_with_the_losses_of_the_processor(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    files = []
    for number in range(3):
        cloud = flow_clouds.FlowCloud(rng.uniform(-20, 20, (3000, 3)).astype(np.float32), np.eye(4))
        files.append(tmp_path / f"{number:06d}.npz")
        cloud.write(files[-1])
    pairs = pairs_of(files)
    learn = partial(train_flow, pairs, {"log": pairs[:1]}, flow.CARD, DEFAULT)
    one, other = _losses_of_both(learn, flow.SETTINGS, tmp_path)
    assert np.allclose(one, other, rtol=0.1)


def test_gndnet_is_trained_with_the_losses_of_the_processor(tmp_path: Path) -> None:
    files = ground_clouds.clouds_of_streets(
        tmp_path / "streets", streets=1, sensors=["hdl32"], seed=2, columns=360
    )
    learn = partial(train_ground, files[:-1], {"street": files[-1:]}, ground.CARD)
    one, other = _losses_of_both(learn, ground.SETTINGS, tmp_path)
    assert np.allclose(one, other, rtol=0.1)


def test_delora_is_trained_with_the_losses_of_the_processor(tmp_path: Path) -> None:
    made = normal_scans.scans_of_streets(
        tmp_path / "streets", streets=1, sensors=["hdl32"], seed=2, columns=360, firings=360
    )
    pairs = pairs_of(made)
    learn = partial(train_odometry, pairs, {"street": pairs[:1]}, odometry.CARD)
    one, other = _losses_of_both(learn, odometry.SETTINGS, tmp_path)
    assert np.allclose(one, other, rtol=0.1)
