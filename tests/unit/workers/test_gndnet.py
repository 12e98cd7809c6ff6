import torch
from torch import Tensor

from workers.lidar.fidelity import Form
from workers.paper.gndnet import GndNet, decorate


def _pillars(*, count: int, shift_m: float = 0.0) -> tuple[Tensor, Tensor, Tensor]:
    rng = torch.Generator().manual_seed(2)
    cells = torch.randperm(10_000, generator=rng)[:count]
    coords = torch.stack((torch.zeros_like(cells), cells // 100, cells % 100), dim=1)
    filled = torch.randint(1, 6, (count,), generator=rng)
    pillars = torch.zeros(count, 5, 4)
    pillars[:, :, :2] = coords[:, None, [2, 1]] + torch.tensor([-46.5, -49.5])
    pillars[:, :, 2:] = torch.rand(count, 5, 2, generator=rng) + shift_m
    pillars[torch.arange(5)[None] >= filled[:, None]] = 0.0
    return pillars, filled, coords


def test_the_published_network_has_its_published_size_and_names_in_both_forms() -> None:
    for net in (GndNet(), GndNet(form=Form.PAPER)):
        assert sum(parameter.numel() for parameter in net.parameters()) == 2_217_089
        keys = list(net.state_dict())
        assert len(keys) == 60
        assert keys[0] == "voxel_feature_extractor.pfn_layers.0.linear.weight"
        assert keys[-1] == "encoder_decoder.regressor.bias"
        assert "encoder_decoder.up1.conv2.cbr_unit.1.running_mean" in keys


def test_a_point_is_described_by_its_way_from_the_mean_and_the_middle() -> None:
    pillar = torch.zeros(1, 3, 4)
    pillar[0, :2] = torch.tensor([[-46.5, -49.0, 1.0, 0.5], [-46.3, -49.2, 2.0, 0.1]])
    described = decorate(pillar, torch.tensor([2]), torch.tensor([[0, 0, 0]]))[0]
    expected = torch.tensor([-46.5, -49.0, 1.0, 0.5, -0.1, 0.1, -0.5, 0.0, 0.5])
    torch.testing.assert_close(described[0], expected, atol=1e-5, rtol=0)
    assert (described[2] == 0).all()


def test_the_map_does_not_depend_on_the_order_of_pillars() -> None:
    torch.manual_seed(1)
    net = GndNet().eval()
    pillars, filled, coords = _pillars(count=400)
    order = torch.randperm(400)
    with torch.inference_mode():
        elevation = net(pillars, filled, coords)
        assert elevation.shape == (100, 100)
        assert (net(pillars[order], filled[order], coords[order]) == elevation).all()


def test_only_the_paper_form_normalises_by_the_cloud_at_hand_and_learns_nothing_of_it() -> None:
    torch.manual_seed(1)
    corrected, paper = GndNet().eval(), GndNet(form=Form.PAPER).eval()
    paper.load_state_dict(corrected.state_dict())
    pillars = _pillars(count=2000)
    with torch.inference_mode():
        assert not torch.allclose(corrected(*pillars), paper(*pillars), atol=1e-2)
        trained = GndNet().train()
        trained.load_state_dict(corrected.state_dict())
        torch.testing.assert_close(trained(*pillars), paper(*pillars), atol=1e-2, rtol=0)
    for key, value in corrected.state_dict().items():
        assert (paper.state_dict()[key] == value).all()
