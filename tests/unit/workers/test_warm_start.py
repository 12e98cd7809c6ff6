from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from workers.checkpoints.errors import WeightsUnusableError
from workers.lab.training.warm_start import warm_start_parameters
from workers.lidar.range_image import CHANNELS, Channel, SensorProfile
from workers.supervised.classes import ClassMeaning
from workers.supervised.lmnet import MOTION_CLASSES
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.weights import LoadedWeights, WeightsCard, load_weights, save_weights

FEWER: tuple[Channel, ...] = ("range", "x", "y", "z")
CARD = WeightsCard(
    network="lmnet",
    classes=tuple(ClassMeaning(name=name) for name in MOTION_CLASSES),
    width=4,
    profile=SensorProfile("test", 16, 64, 20, -20, means=(20, 0, 1, -1, 0.1), stds=(9, 8, 7, 2, 3)),
    residual=ResidualSettings(ages_s=(0.1, 0.2), max_range_m=100),
    attribution="made in a test",
    data_license="CC0",
)


def _initial(folder: Path, card: WeightsCard = CARD) -> LoadedWeights:
    torch.manual_seed(1)
    save_weights(folder / "w.safetensors", card.build(), card)
    return load_weights(folder / "w.safetensors")


def test_a_network_that_sees_less_answers_as_if_the_rest_were_at_its_mean(tmp_path: Path) -> None:
    initial = _initial(tmp_path)
    card = CARD.model_copy(update={"channels": FEWER})
    net = card.build().eval()
    net.load_state_dict(warm_start_parameters(initial, card))
    image = np.random.default_rng(1).normal(size=(1, len(CHANNELS) + 2, 16, 64)).astype(np.float32)
    image[:, CHANNELS.index("intensity")] = 0
    fewer = np.delete(image, CHANNELS.index("intensity"), axis=1)
    with torch.inference_mode():
        torch.testing.assert_close(net(torch.from_numpy(fewer)), initial.net(torch.tensor(image)))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"width": 8}, "agree"),
        ({"residual": ResidualSettings(ages_s=(0.1,), max_range_m=100)}, "agree"),
        ({"profile": replace(CARD.profile, means=(0, 0, 0, 0, 0))}, "same normalisation"),
    ],
)
def test_weights_of_another_network_are_refused(
    tmp_path: Path, change: dict[str, object], why: str
) -> None:
    with pytest.raises(WeightsUnusableError, match=why):
        warm_start_parameters(_initial(tmp_path), CARD.model_copy(update=change))


def test_a_channel_that_was_never_seen_is_refused(tmp_path: Path) -> None:
    initial = _initial(tmp_path, CARD.model_copy(update={"channels": FEWER}))
    with pytest.raises(WeightsUnusableError, match="intensity"):
        warm_start_parameters(initial, CARD)
