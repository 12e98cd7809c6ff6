import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

from workers.supervised.lmnet import LMNet
from workers.supervised.salsanext import SalsaNext


def test_the_published_network_has_its_published_size_and_names() -> None:
    net = SalsaNext()
    assert sum(parameter.numel() for parameter in net.parameters()) == 6_711_572
    keys = list(net.state_dict())
    assert len(keys) == 312
    assert keys[0] == "downCntx.conv1.weight"
    assert keys[-1] == "logits.bias"
    assert "resBlock5.bn4.running_var" in keys
    assert tuple(net.state_dict()["upBlock1.conv1.weight"].shape) == (128, 320, 3, 3)


def test_lmnet_is_the_same_body_with_one_more_channel_per_past_frame() -> None:
    net = LMNet(residuals=8)
    assert sum(parameter.numel() for parameter in net.parameters()) == 6_711_267
    assert len(net.state_dict()) == 312
    assert tuple(net.downCntx.conv1.weight.shape) == (32, 13, 1, 1)
    assert net.logits.out_channels == 3


@pytest.mark.parametrize("width", [4, 8])
def test_any_width_answers_with_shares_that_sum_to_one(width: int) -> None:
    net = SalsaNext(in_channels=7, classes=5, width=width).eval()
    with torch.inference_mode():
        shares = net(torch.randn(2, 7, 16, 48, generator=torch.Generator().manual_seed(1)))
    assert shares.shape == (2, 5, 16, 48)
    torch.testing.assert_close(shares.sum(dim=1), torch.ones(2, 16, 48))


def test_a_gradient_reaches_every_parameter() -> None:
    net = SalsaNext(classes=3, width=4, dropout=0.0)
    net.forward_logits(torch.randn(1, 5, 32, 64)).square().sum().backward()  # type: ignore[no-untyped-call]
    assert [name for name, value in net.named_parameters() if value.grad is None] == []


@pytest.mark.parametrize("width", [0, 6, -4])
def test_a_width_that_pixel_shuffling_cannot_split_is_refused(width: int) -> None:
    with pytest.raises(ValueError, match="multiple of 4"):
        SalsaNext(width=width)


def _recipe(golden: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("fill_parameters", golden / "fill_parameters.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.reference
@pytest.mark.parametrize("case", ["batch2_32x64", "random_64x256", "real_64x512"])
@pytest.mark.parametrize("name", ["salsanext", "lmnet"])
def test_the_networks_answer_as_the_published_ones_do(
    reference: Path, name: str, case: str
) -> None:
    networks = reference / "golden" / "networks"
    net = SalsaNext() if name == "salsanext" else LMNet(residuals=8)
    filled = _recipe(reference / "golden").fill(networks / f"{name}_parameters.json")
    assert list(filled) == list(net.state_dict())
    net.load_state_dict({key: torch.from_numpy(value) for key, value in filled.items()})
    golden = np.load(networks / f"{name}_{case}.npz")
    with torch.inference_mode():
        shares = net.eval()(torch.from_numpy(golden["input"])).numpy()
    np.testing.assert_allclose(shares, golden["softmax"], atol=1e-5)
    second, first = np.sort(shares, axis=1)[:, -2:].swapaxes(0, 1)
    clear = first - second > 1e-5
    assert (shares.argmax(axis=1)[clear] == golden["argmax"][clear]).all()
