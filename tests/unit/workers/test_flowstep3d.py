import pytest
import torch
from torch import Tensor

from workers.lidar.fidelity import Form
from workers.paper.flowstep3d import FlowStep3D


def _cloud(*, count: int, seed: int = 1, batch: int = 1) -> Tensor:
    return torch.rand(batch, count, 3, generator=torch.Generator().manual_seed(seed)) * 10


def _net(**settings: float | Form) -> FlowStep3D:
    torch.manual_seed(3)
    return FlowStep3D(**settings).eval()  # type: ignore[arg-type]


def test_the_published_network_has_its_published_size_and_names() -> None:
    net = FlowStep3D()
    assert sum(parameter.numel() for parameter in net.parameters()) == 689_239
    keys = list(net.state_dict())
    assert len(keys) == 281
    assert keys[0] == "encoder_loc.sa1.mlp_convs.0.weight"
    assert {"global_corr_layer.epsilon", "gru.convz.mlp_bns.0.running_var"} <= set(keys)
    assert tuple(net.state_dict()["gru.convq.mlp_convs.0.weight"].shape) == (128, 342, 1, 1)


@pytest.mark.parametrize(("count", "next_count"), [(120, 90), (1, 1), (40, 2000)])
def test_clouds_of_any_size_get_a_flow_for_every_point(count: int, next_count: int) -> None:
    with torch.inference_mode():
        flows = _net()(_cloud(count=count), _cloud(count=next_count, seed=2), iterates=3)
    assert [flow.shape for flow in flows] == [(1, count, 3)] * 3
    assert all(bool(flow.isfinite().all()) for flow in flows)


def test_each_pair_of_a_batch_gets_the_flow_it_gets_alone() -> None:
    net, cloud, then = _net(), _cloud(count=150, batch=2), _cloud(count=140, seed=2, batch=2)
    with torch.inference_mode():
        together = net(cloud, then, iterates=2)[-1]
        alone = [net(cloud[i : i + 1], then[i : i + 1], iterates=2)[-1] for i in range(2)]
    torch.testing.assert_close(together, torch.cat(alone), atol=1e-4, rtol=1e-4)


def test_a_small_cloud_is_sampled_at_its_own_size_and_published_at_that_of_the_training() -> None:
    assert _net().level_sizes(1000) == (500, 250, 125, 62, 31)
    assert _net().level_sizes(100_000) == (4096, 2048, 1024, 512, 256)
    assert _net(form=Form.PAPER).level_sizes(1000) == (4096, 2048, 1024, 512, 256)


def test_both_forms_agree_on_clouds_as_large_as_those_of_the_training() -> None:
    cloud, then = _cloud(count=256), _cloud(count=300, seed=2)
    with torch.inference_mode():
        corrected = _net(points=256)(cloud, then, iterates=2)[-1]
        paper = _net(points=256, form=Form.PAPER)(cloud, then, iterates=2)[-1]
    assert (corrected == paper).all()


def test_steps_are_divided_more_and_more() -> None:
    cloud, then = _cloud(count=200), _cloud(count=200, seed=2)
    with torch.inference_mode():
        plain = _net(decay=0.0)(cloud, then, iterates=3)
        decayed = _net(decay=0.5)(cloud, then, iterates=3)
    assert (plain[1] == decayed[1]).all()
    step, smaller = plain[2] - plain[1], decayed[2] - decayed[1]
    torch.testing.assert_close(step / 1.5, smaller, atol=1e-5, rtol=1e-3)


def test_a_gradient_reaches_every_parameter_that_is_used() -> None:
    net = FlowStep3D().train()
    flows = net(_cloud(count=300), _cloud(count=300, seed=2), iterates=3)
    torch.stack(flows).square().sum().backward()  # type: ignore[no-untyped-call]
    without = {name for name, value in net.named_parameters() if value.grad is None}
    assert without == {
        f"{layer}.mlp_bns.0.{which}"
        for layer in ("h0_net.sa2", "gru.convz", "gru.convr", "gru.convq")
        for which in ("weight", "bias")
    }


@pytest.mark.parametrize(("count", "next_count", "iterates"), [(0, 5, 2), (5, 0, 2), (5, 5, 0)])
def test_nothing_to_compare_is_refused(count: int, next_count: int, iterates: int) -> None:
    with pytest.raises(ValueError, match="flow needs points in both clouds"):
        _net()(_cloud(count=count), _cloud(count=next_count), iterates=iterates)
