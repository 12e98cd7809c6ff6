from dataclasses import replace

import pytest
import torch

from workers.lab.training.elevation_loss import elevation_loss, second_order_smoothness
from workers.lab.training.flow_loss import (
    FINE_TUNING,
    PRE_TRAINING,
    ball_neighbours,
    chamfer,
    flow_loss,
    nearest_neighbours,
    smoothness,
)

LINE = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [5.0, 0, 0]])


def test_the_distance_between_clouds_is_that_to_the_nearest_both_ways() -> None:
    other = LINE + torch.tensor([0.0, 0.5, 0.0])
    assert float(chamfer(LINE, other)) == pytest.approx(1.0)
    assert float(chamfer(LINE, LINE)) == 0.0
    assert float(chamfer(LINE[:3], LINE)) == pytest.approx(4.8 / 4)


def test_neighbours_beyond_the_radius_become_the_point_itself() -> None:
    found = nearest_neighbours(LINE, 3, radius_m=0.15)
    assert found.tolist() == [[0, 1, 0], [1, 0, 2], [2, 1, 2], [3, 3, 3]]


def test_the_ball_takes_the_first_by_index_and_fills_up_with_the_first() -> None:
    found = ball_neighbours(LINE, 4, radius_m=0.15)
    assert found.tolist() == [[0, 1, 0, 0], [0, 1, 2, 0], [1, 2, 1, 1], [3, 3, 3, 3]]
    assert ball_neighbours(LINE, 2, radius_m=10.0).tolist() == [[0, 1]] * 4
    assert ball_neighbours(LINE, 6, radius_m=0.01).shape == (4, 6)


def test_flow_that_is_the_same_everywhere_is_smooth() -> None:
    neighbours = nearest_neighbours(LINE, 3, radius_m=1.0)
    assert float(smoothness(torch.ones(4, 3), neighbours)) == 0.0
    flow = torch.zeros(4, 3)
    flow[1] = 1.0
    assert float(smoothness(flow, neighbours)) == pytest.approx(3 * 4 / 12)


def test_the_total_weighs_iterates_and_their_parts() -> None:
    settings = replace(PRE_TRAINING, iterate=(0.5, 2.0), data=(1.0, 1.0), smoothness=(0.0, 0.0))
    right = torch.tensor([0.0, 0.5, 0.0]).expand(4, 3)
    total, parts = flow_loss(LINE, LINE + right, [torch.zeros(4, 3), right], settings)
    assert [float(each.loss) for each in parts] == pytest.approx([1.0, 0.0], abs=1e-6)
    assert float(total) == pytest.approx(0.5)


def test_a_gradient_leads_the_flow_to_the_other_cloud() -> None:
    flow = torch.zeros(4, 3, requires_grad=True)
    total, _ = flow_loss(LINE, LINE + torch.tensor([0.0, 0.5, 0.0]), [flow] * 4, FINE_TUNING)
    (gradient,) = torch.autograd.grad(total, flow)
    assert (gradient[:, 1] < 0).all()
    assert (gradient[:, 2] == 0).all()


def test_another_number_of_iterates_is_refused() -> None:
    with pytest.raises(ValueError, match="weigh 4 iterates, the network gave 1"):
        flow_loss(LINE, LINE, [torch.zeros(4, 3)], PRE_TRAINING)


def test_a_plane_is_smooth_and_a_bump_is_not() -> None:
    plane = (torch.arange(8.0)[:, None] * 0.3 + torch.arange(6.0)).expand(2, 8, 6).clone()
    assert float(second_order_smoothness(plane)) == pytest.approx(0, abs=1e-6)
    assert float(elevation_loss(plane, plane)) == pytest.approx(0, abs=1e-6)
    bump = plane.clone()
    bump[0, 3, 3] += 2
    assert float(second_order_smoothness(bump)) > 0.1
    assert float(elevation_loss(plane, plane + 2)) == pytest.approx(0.9 * 1.5, abs=1e-6)
