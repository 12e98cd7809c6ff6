import pytest
import torch
from torch import Tensor

from workers.lidar.fidelity import Form
from workers.paper.delora import DeLORA, matrix


def _images(*, batch: int = 2) -> tuple[Tensor, Tensor]:
    rng = torch.Generator().manual_seed(1)
    return torch.randn(batch, 4, 16, 64, generator=rng), torch.randn(
        batch, 4, 16, 64, generator=rng
    )


def test_the_published_network_has_its_published_size_and_names() -> None:
    net = DeLORA()
    assert sum(parameter.numel() for parameter in net.parameters()) == 11_876_019
    keys = list(net.state_dict())
    assert len(keys) == 30
    assert keys[0] == "resnet.conv1.weight"
    assert "resnet.layer2.0.downsample.0.weight" in keys
    assert keys[-1] == "fully_connected_translation.3.bias"


def test_each_quaternion_has_length_one_but_in_the_paper_form_the_whole_batch_has() -> None:
    torch.manual_seed(1)
    corrected, paper = DeLORA().eval(), DeLORA(form=Form.PAPER).eval()
    paper.load_state_dict(corrected.state_dict())
    with torch.inference_mode():
        one, whole = corrected(*_images()), paper(*_images())
    torch.testing.assert_close(one.quaternion_xyzw.norm(dim=1), torch.ones(2))
    assert float(whole.quaternion_xyzw.norm()) == pytest.approx(1.0, abs=1e-6)
    assert (one.this_from_next == whole.this_from_next).all()


def test_a_panorama_has_no_seam() -> None:
    torch.manual_seed(1)
    net = DeLORA().eval()
    first, second = _images(batch=1)
    with torch.inference_mode():
        plain = net(first, second).translation_m
        turned = net(first.roll(32, dims=3), second.roll(32, dims=3)).translation_m
    torch.testing.assert_close(plain, turned, atol=1e-6, rtol=0)


def test_a_quarter_turn_to_the_left_maps_forward_to_left() -> None:
    half = 0.5**0.5
    quaternion = torch.tensor([[0.0, 0.0, half, half]])
    built = matrix(torch.tensor([[1.0, 2.0, 3.0]]), quaternion)[0]
    moved = built @ torch.tensor([1.0, 0.0, 0.0, 1.0])
    torch.testing.assert_close(moved, torch.tensor([1.0, 3.0, 3.0, 1.0]))
    torch.testing.assert_close(built[:3, :3] @ built[:3, :3].t(), torch.eye(3))
