import json
from collections.abc import Callable
from pathlib import Path

import pytest
import safetensors.torch
import torch

from schemas.errors import PermanentError
from workers.checkpoints.errors import WeightsUnusableError
from workers.lidar.range_image import SensorProfile
from workers.supervised.classes import ClassMeaning
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.weights import (
    WeightsCard,
    load_weights,
    save_weights,
)

CARD = WeightsCard(
    network="salsanext",
    classes=(ClassMeaning(name="unlabeled"), ClassMeaning(name="car", movable=True)),
    width=4,
    profile=SensorProfile(name="test", rows=16, columns=32, fov_up_deg=10, fov_down_deg=-10),
    attribution="made in a test",
    data_license="CC0",
    training={"seed": 1},
)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    torch.manual_seed(1)
    path = tmp_path / "net.safetensors"
    save_weights(path, CARD.build(), CARD)
    return path


def test_what_was_saved_is_loaded(saved: Path) -> None:
    torch.manual_seed(1)
    original = CARD.build().eval()
    loaded = load_weights(saved)
    assert loaded.card == CARD
    assert not loaded.net.training
    x = torch.randn(1, 5, 16, 32)
    with torch.inference_mode():
        torch.testing.assert_close(loaded.net(x), original(x), atol=2e-3, rtol=0)


def test_the_digest_follows_the_numbers_and_the_sidecar(saved: Path) -> None:
    before = load_weights(saved).digest
    assert load_weights(saved).digest == before
    sidecar = saved.with_suffix(".json")
    sidecar.write_text(sidecar.read_text().replace("made in a test", "made elsewhere"))
    after = load_weights(saved).digest
    assert after != before
    torch.manual_seed(2)
    save_weights(saved, CARD.build(), CARD)
    assert load_weights(saved).digest not in {before, after}


def _without(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {key: value for key, value in tensors.items() if key != "logits.bias"}


def _with(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {**tensors, "logits.scale": torch.ones(1)}


def _other_shape(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {**tensors, "logits.bias": torch.ones(7)}


def _not_a_number(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {**tensors, "logits.bias": torch.full((2,), float("nan"))}


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        pytest.param(_without, r"lack 1 parameter: logits.bias \(", id="missing"),
        pytest.param(_with, "hold 1 parameter that the network has not: logits.scale", id="extra"),
        pytest.param(_other_shape, r"logits.bias are \(7,\), the network needs \(2,\)", id="shape"),
        pytest.param(_not_a_number, "logits.bias are not all finite", id="not a number"),
    ],
)
def test_weights_that_do_not_fit_are_refused_by_name(
    saved: Path,
    damage: Callable[[dict[str, torch.Tensor]], dict[str, torch.Tensor]],
    message: str,
) -> None:
    safetensors.torch.save_file(damage(safetensors.torch.load_file(saved)), saved)
    with pytest.raises(WeightsUnusableError, match=message) as refused:
        load_weights(saved)
    assert str(saved) in str(refused.value)


@pytest.mark.parametrize("suffix", [".safetensors", ".json"])
def test_a_missing_file_is_named(saved: Path, suffix: str) -> None:
    saved.with_suffix(suffix).unlink()
    with pytest.raises(PermanentError, match=f"No such file or directory.*{suffix}\\)"):
        load_weights(saved)


def test_a_truncated_file_is_refused(saved: Path) -> None:
    saved.write_bytes(saved.read_bytes()[:-100])
    with pytest.raises(WeightsUnusableError, match="weights are damaged"):
        load_weights(saved)


def test_a_sidecar_with_an_unknown_word_is_refused(saved: Path) -> None:
    sidecar = saved.with_suffix(".json")
    sidecar.write_text(json.dumps(json.loads(sidecar.read_text()) | {"colour": "red"}))
    with pytest.raises(WeightsUnusableError, match="sidecar is not valid: colour"):
        load_weights(saved)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"network": "lmnet"}, id="lmnet without residuals"),
        pytest.param({"residual": ResidualSettings()}, id="salsanext with residuals"),
        pytest.param({"network": "lmnet", "residual": ResidualSettings()}, id="two motion classes"),
    ],
)
def test_a_sidecar_that_contradicts_itself_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(WeightsUnusableError, match="lmnet"):
        CARD.model_copy(update=change).build()
