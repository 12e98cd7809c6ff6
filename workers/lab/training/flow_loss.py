"""Self-supervised loss of FlowStep3D, as published: chamfer distance plus flow smoothness.

Source: Kittenplon, Eldar, Raviv, "FlowStep3D: Model Unrolling for Self-Supervised Scene Flow
Estimation", CVPR 2021, and its code, which has no Laplacian term. All functions take one pair of
clouds and are differentiable in the flow; neighbours are searched without gradient.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor
from torch.nn import functional

from workers.paper.point_sets import distances_at_once, find_nearest, squared_distances


@dataclass(frozen=True, slots=True)
class FlowLossSettings:
    """Weights of the loss terms, by iterate of the network, and the choice of neighbours.

    Attributes:
        iterate: Weight of each iterate's loss in the total.
        data: Weight of the chamfer distance in each.
        smoothness: Weight of both smoothness terms in each.
        knn_weight: Weight of the smoothness over nearest neighbours.
        knn_neighbours: Number of nearest neighbours, the point itself included.
        knn_radius_m: Neighbours beyond it are replaced by the nearest: the point itself.
        ball_weight: Weight of the smoothness over the ball.
        ball_neighbours: Largest number in the ball: those with the lowest indices.
        ball_radius_m: Radius of the ball, metres.
    """

    iterate: tuple[float, ...]
    data: tuple[float, ...]
    smoothness: tuple[float, ...]
    knn_weight: float
    ball_weight: float
    ball_neighbours: int
    ball_radius_m: float
    knn_neighbours: int = 16
    knn_radius_m: float = 0.25


PRE_TRAINING: Final = FlowLossSettings(
    iterate=(0.8, 0.2, 0.4, 0.6),
    data=(0.75, 0.75, 0.75, 0.75),
    smoothness=(0.25, 0.25, 0.25, 0.25),
    knn_weight=3.0,
    ball_weight=1.0,
    ball_neighbours=64,
    ball_radius_m=0.75,
)
FINE_TUNING: Final = FlowLossSettings(
    iterate=(0.5, 0.3, 0.3, 0.3),
    data=(0.65, 0.7, 0.7, 0.7),
    smoothness=(0.35, 0.3, 0.3, 0.3),
    knn_weight=4.0,
    ball_weight=1.0,
    ball_neighbours=48,
    ball_radius_m=0.5,
)


@dataclass(frozen=True, slots=True, eq=False)
class IterateLoss:
    """The parts of one iterate's loss, scalars.

    Attributes:
        chamfer: Mean distance to the nearest point, both ways added.
        knn_smoothness: Mean difference of flow to the nearest neighbours.
        ball_smoothness: The same to the neighbours in the ball.
        loss: The weighted sum.
    """

    chamfer: Tensor
    knn_smoothness: Tensor
    ball_smoothness: Tensor
    loss: Tensor


def flow_loss(
    points_m: Tensor, other_points_m: Tensor, flows_m: Sequence[Tensor], settings: FlowLossSettings
) -> tuple[Tensor, list[IterateLoss]]:
    """Compute the loss of every iterate of the flow between two clouds.

    Args:
        points_m: (N, 3) source cloud.
        other_points_m: (M, 3) target cloud.
        flows_m: One (N, 3) flow for each iterate of the network, first to last.
        settings: `PRE_TRAINING`, `FINE_TUNING`, or others with as many iterates.

    Returns:
        The total, and the parts of each iterate.

    Raises:
        ValueError: If the settings have weights for another number of iterates.
    """
    if len(flows_m) != len(settings.iterate):
        raise ValueError(
            f"the settings weigh {len(settings.iterate)} iterates, the network gave {len(flows_m)}"
        )
    knn = nearest_neighbours(points_m, settings.knn_neighbours, radius_m=settings.knn_radius_m)
    ball = ball_neighbours(points_m, settings.ball_neighbours, radius_m=settings.ball_radius_m)
    parts = []
    total = points_m.new_zeros(())
    weights = zip(flows_m, settings.iterate, settings.data, settings.smoothness, strict=True)
    for flow_m, iterate, data, smooth in weights:
        meets = chamfer(points_m + flow_m, other_points_m)
        near, around = smoothness(flow_m, knn), smoothness(flow_m, ball)
        loss = data * meets + smooth * (settings.knn_weight * near + settings.ball_weight * around)
        parts.append(IterateLoss(meets, near, around, loss))
        total = total + iterate * loss
    return total, parts


def chamfer(points_m: Tensor, other_points_m: Tensor) -> Tensor:
    """Return the mean distance from each point to the nearest of the other cloud, both ways added.

    The published code adds both ways per point and so needs equally many points. The mean of the
    sums is the sum of the means, which does not need that.
    """
    there = other_points_m[_nearest(points_m, other_points_m, 1)[:, 0]]
    back = points_m[_nearest(other_points_m, points_m, 1)[:, 0]]
    ways = (points_m - there, other_points_m - back)
    return torch.stack([torch.linalg.vector_norm(way, dim=1).mean() for way in ways]).sum()


def smoothness(flow_m: Tensor, neighbours: Tensor) -> Tensor:
    """Return the mean L1 difference between the flow of each point and of its neighbours.

    Args:
        flow_m: (N, 3).
        neighbours: (N, k) indices; the point itself may be among them, and counts.
    """
    apart: Tensor = (flow_m[neighbours] - flow_m[:, None]).abs().sum(dim=2)
    return apart.mean()


def nearest_neighbours(points_m: Tensor, count: int, *, radius_m: float) -> Tensor:
    """Find the nearest points of each, itself first; points beyond the radius become the nearest.

    Returns:
        (N, count) int64; of equally near points the lower index is first.
    """
    found = _nearest(points_m, points_m, count)
    apart = torch.linalg.vector_norm(points_m[found] - points_m[:, None], dim=2)
    return torch.where(apart > radius_m, found[:, :1], found)


def ball_neighbours(points_m: Tensor, count: int, *, radius_m: float) -> Tensor:
    """Find the first points, by index, inside the radius; the first one pads a smaller number.

    Returns:
        (N, count) int64.
    """
    points, n = points_m.detach()[None], len(points_m)
    index = torch.arange(n, device=points_m.device)
    rows = []
    for block in torch.split(points, max(1, distances_at_once(points) // n), dim=1):
        inside = squared_distances(block, points)[0] < radius_m**2
        first = torch.where(inside, index, n).topk(min(count, n), largest=False, sorted=True).values
        first = functional.pad(first, (0, count - first.shape[1]), value=n)
        rows.append(torch.where(first == n, first[:, :1], first))
    return torch.cat(rows)


def _nearest(points_m: Tensor, other_points_m: Tensor, count: int) -> Tensor:
    """(N, count) indices of the nearest others, nearest first; found without gradient."""
    return find_nearest(points_m.detach()[None], other_points_m.detach()[None], count)[1][0]
