import pytest
import torch
from torch import Tensor, nn

from workers.lidar.fidelity import Form
from workers.parts.registry import build_supervised
from workers.supervised.folded import FoldedSalsaNext
from workers.supervised.lmnet import LMNet
from workers.supervised.salsanext import SalsaNext
from workers.supervised.stream import SHIPPED, RangeImageStream
from workers.supervised.weights import load_weights


def _lived_in(net: SalsaNext) -> SalsaNext:
    """Statistics as training leaves them, scales of both signs among them."""
    rng = torch.Generator().manual_seed(2)
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d):
            assert module.running_mean is not None
            assert module.running_var is not None
            with torch.no_grad():
                module.running_mean.normal_(0, 0.5, generator=rng)
                module.running_var.uniform_(0.3, 2.0, generator=rng)
                module.weight.normal_(0.5, 1.0, generator=rng)
                module.bias.normal_(0, 0.5, generator=rng)
    with torch.no_grad():
        net.logits.weight *= 20
    return net.eval()


def _image(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("size", [(16, 16), (16, 48), (64, 96), (32, 256)])
@pytest.mark.parametrize("batch", [1, 2])
def test_folding_changes_nothing_but_rounding_up_to_the_last_pixel_at_the_edge(
    size: tuple[int, int], batch: int
) -> None:
    torch.manual_seed(1)
    net = _lived_in(SalsaNext(classes=6, width=8))
    image = _image(batch, 5, *size)
    with torch.inference_mode():
        exact = net.double()(image.double())
        folded = FoldedSalsaNext(net.float())(image)
    assert exact.max() > 0.5, "classes must differ, or nothing is compared"
    torch.testing.assert_close(folded.double(), exact, atol=2e-4, rtol=0)


def test_the_shipped_networks_answer_the_same_class_in_every_pixel() -> None:
    for name in ("salsanext", "lmnet"):
        net = load_weights(SHIPPED / f"{name}.safetensors").net
        image = _image(1, net.downCntx.conv1.in_channels, 64, 512)
        with torch.inference_mode():
            eager, folded = net(image), FoldedSalsaNext(net)(image)
        torch.testing.assert_close(folded, eager, atol=5e-5, rtol=0)
        assert float((folded.argmax(dim=1) != eager.argmax(dim=1)).float().mean()) < 0.001


def test_the_network_that_was_folded_is_left_alone() -> None:
    net = LMNet(residuals=2, width=4)
    before = {name: value.clone() for name, value in net.state_dict().items()}
    FoldedSalsaNext(net)(_image(1, 7, 32, 32))
    assert net.training
    assert all(bool((net.state_dict()[name] == value).all()) for name, value in before.items())


@pytest.mark.parametrize(
    ("name", "form", "folded"),
    [
        ("salsanext-lmnet", Form.CORRECTED, True),
        ("salsanext-lmnet:published", Form.PAPER, False),
    ],
)
def test_networks_run_folded_but_for_the_published_form_and_versions_say_so(
    name: str, form: Form, folded: bool
) -> None:
    semantic, motion = (
        load_weights(SHIPPED / f"{network}.safetensors", folded=folded)
        for network in ("salsanext", "lmnet")
    )
    assert semantic.digest.endswith("folded") == folded
    composed = RangeImageStream(semantic, motion, name="salsanext-lmnet", form=form)
    assert build_supervised(name).version == composed.version


def test_without_onednn_networks_run_layer_by_layer_and_the_digest_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = SHIPPED / "lmnet.safetensors"
    plain = load_weights(path).digest
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: False)
    assert load_weights(path, folded=True).digest == plain
