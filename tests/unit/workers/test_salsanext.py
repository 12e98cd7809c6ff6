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
