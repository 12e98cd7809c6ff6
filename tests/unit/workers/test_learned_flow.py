"""FlowStep3D as a scene flow of the two-stage rule: what it is asked, and what it needs."""

from pathlib import Path

import numpy as np
import pytest
import torch

from tests import factories
from workers.checkpoints import stored_weights
from workers.errors import UnknownPartError
from workers.paper.learned_flow import REACH_M, FlowStep3DFlow
from workers.paper.weights import load_flowstep3d
from workers.parts.files import PartFiles
from workers.parts.networks import read_config
from workers.parts.registry import build_selfsupervised
from workers.points.se3 import transform

EGO = factories.pose(1.5, 0.2, 0.05)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(7)
    card = read_config("flowstep3d", "flowstep3d")
    stored_weights.save(folder / "flowstep3d.safetensors", card.build().state_dict(), card)
    return folder


def _cloud(seed: int, points: int = 128) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    rng = np.random.default_rng(seed)
    return rng.uniform((-30, -30, -1), (30, 30, 2), (points, 3)).astype(np.float32)


def test_the_network_is_asked_for_what_ego_motion_leaves_in_the_axes_it_was_trained_with(
    weights: Path,
) -> None:
    here, there = _cloud(1), _cloud(2)
    flow = FlowStep3DFlow.load(weights)(here, there, EGO)
    expected = transform(EGO, here).astype(np.float32)
    net = load_flowstep3d(weights / "flowstep3d.safetensors").net
    with torch.inference_mode():  # x left, y up, z ahead
        clouds = [torch.from_numpy(cloud[:, [1, 2, 0]].copy())[None] for cloud in (expected, there)]
        beyond = net(*clouds, iterates=5)[-1][0].numpy()[:, [2, 0, 1]]
    assert flow.shape == here.shape
    assert np.abs(beyond).max() > 1e-3  # else nothing is compared
    np.testing.assert_allclose(flow, expected + beyond - here, atol=1e-4)


def test_what_is_farther_than_the_training_saw_stands_still(weights: Path) -> None:
    far = _cloud(3)
    far[:, 0] += REACH_M + 40
    here = np.concatenate([_cloud(1), far])
    flow = FlowStep3DFlow.load(weights)(here, _cloud(2), EGO)
    standing = transform(EGO, here) - here
    np.testing.assert_allclose(flow[128:], standing[128:], atol=1e-4)
    assert np.abs(flow[:128] - standing[:128]).max() > 1e-3


@pytest.mark.parametrize(("here", "there"), [(0, 50), (50, 0)])
def test_an_empty_cloud_has_the_flow_of_a_standing_world(
    weights: Path, here: int, there: int
) -> None:
    points_m = _cloud(1, here)
    flow = FlowStep3DFlow.load(weights)(points_m, _cloud(2, there), EGO)
    np.testing.assert_allclose(flow, transform(EGO, points_m) - points_m, atol=1e-5)


def test_the_stream_says_what_weights_it_needs_and_other_weights_are_another_version(
    weights: Path, tmp_path: Path
) -> None:
    with pytest.raises(UnknownPartError, match=r"two-stage:flowstep3d needs .*\(flowstep3d\)"):
        build_selfsupervised("two-stage:flowstep3d")
    card = read_config("flowstep3d", "flowstep3d")
    stored_weights.save(tmp_path / "flowstep3d.safetensors", card.build().state_dict(), card)
    versions = {
        build_selfsupervised(name, PartFiles(weights=str(folder))).version
        for name in ("two-stage:flowstep3d", "two-stage:flowstep3d:published")
        for folder in (weights, tmp_path)
    }
    assert len(versions) == 4
