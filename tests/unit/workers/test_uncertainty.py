import pytest
import torch
from torch import Tensor, nn

from workers.supervised.lmnet import LMNet
from workers.supervised.salsanext import SalsaNext
from workers.supervised.uncertainty import mc_dropout


def _images(channels: int = 5) -> Tensor:
    return torch.randn(2, channels, 16, 32, generator=torch.Generator().manual_seed(1))


def _net(**settings: float) -> SalsaNext:
    torch.manual_seed(1)
    return SalsaNext(classes=4, width=8, **settings).eval()  # type: ignore[arg-type]


def test_mean_and_variance_are_those_of_the_single_passes() -> None:
    net, images = _net(), _images()
    asked = mc_dropout(net, images, passes=6, seed=5)
    with torch.random.fork_rng(), torch.inference_mode():
        torch.manual_seed(5)
        for module in net.modules():
            if isinstance(module, nn.Dropout2d):
                module.train()
        answers = torch.stack([net(images) for _ in range(6)])
    torch.testing.assert_close(asked.mean, answers.mean(dim=0))
    winner = answers.mean(dim=0).argmax(dim=1, keepdim=True)
    variance = answers.var(dim=0, unbiased=False).gather(1, winner)[:, 0]
    torch.testing.assert_close(asked.uncertainty, variance, atol=1e-7, rtol=1e-3)
    assert asked.uncertainty.max() > 0


def test_a_seed_repeats_the_answer_and_leaves_the_modes_and_all_other_chance_alone() -> None:
    net, images = _net(), _images()
    net.resBlock2.train()
    modes = [module.training for module in net.modules()]
    state = torch.get_rng_state()
    first, again = (mc_dropout(net, images, passes=3, seed=2) for _ in range(2))
    assert (torch.get_rng_state() == state).all()
    assert [module.training for module in net.modules()] == modes
    assert (first.uncertainty == again.uncertainty).all()
    assert (mc_dropout(net, images, passes=3, seed=3).mean != first.mean).any()


def test_lmnet_is_asked_the_same_way() -> None:
    net = LMNet(residuals=1, width=8).eval()
    assert mc_dropout(net, _images(6), passes=2).uncertainty.shape == (2, 16, 32)


@pytest.mark.parametrize(("dropout", "passes"), [(0.0, 5), (0.2, 1)])
def test_without_chance_there_is_no_uncertainty(dropout: float, passes: int) -> None:
    with pytest.raises(ValueError, match="at least two passes and a network with dropout"):
        mc_dropout(_net(dropout=dropout), _images(), passes=passes)
