import torch

from workers.lab.evaluation.benchmarks import published_forward
from workers.paper.flowstep3d import FlowStep3D
from workers.supervised.salsanext import SalsaNext


def test_the_plain_salsanext_is_the_same_function() -> None:
    torch.manual_seed(1)
    net = SalsaNext(classes=4, width=8).eval()
    image = torch.randn(2, 5, 32, 48)
    with torch.inference_mode():
        assert torch.equal(published_forward.salsanext(net, image), net(image))


def test_the_plain_flowstep3d_is_the_same_function() -> None:
    torch.manual_seed(1)
    net = FlowStep3D(points=512).eval()
    cloud, then = torch.rand(1, 700, 3) * 8, torch.rand(1, 600, 3) * 8
    with torch.inference_mode():
        plain = published_forward.flowstep3d(net, cloud, then, iterates=4)
        torch.testing.assert_close(plain, net(cloud, then, iterates=4)[-1], atol=1e-5, rtol=1e-4)
