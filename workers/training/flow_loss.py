"""The published loss of FlowStep3D: no labels, the flow must meet the next frame and be smooth.

Source: Kittenplon, Eldar, Raviv, "FlowStep3D: Model Unrolling for Self-Supervised Scene Flow
Estimation", CVPR 2021, and its code, which has no Laplacian term. All functions take one pair of
clouds and are differentiable in the flow; which points are neighbours is found without gradient.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

_BLOCK: Final = 512
"""Points whose distances to all others are in memory at once: with 100,000 others 0.2 GB, and three
times that while they are sorted."""


@dataclass(frozen=True, slots=True)
class FlowLossSettings:
    """How the parts are weighed, by iterate of the network, and how neighbours are chosen.

    Attributes:
        iterate: Weight of each iterate's loss in the total.
        data: Weight of the chamfer distance in each.
        smoothness: Weight of both smoothness terms in each.
        knn_weight: Of the smoothness over nearest neighbours.
        knn_neighbours: How many, the point itself among them.
        knn_radius_m: Farther ones are replaced by the nearest: the point itself.
        ball_weight: Of the smoothness over the ball.
        ball_neighbours: How many at most: those with the lowest indices.
        ball_radius_m: Of the ball.
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
    """Judge every iterate of the flow between two clouds.

    Args:
        points_m: (N, 3) the cloud that flows.
        other_points_m: (M, 3) the cloud that it should meet.
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
    """Mean distance from each point to the nearest of the other cloud, both ways added.

    The published code adds both ways point by point and so needs equally many points; the mean of
    the sums is the sum of the means, which does not.
    """
    there = other_points_m[_nearest(points_m, other_points_m, 1)[:, 0]]
    back = points_m[_nearest(other_points_m, points_m, 1)[:, 0]]
    ways = (points_m - there, other_points_m - back)
    return torch.stack([torch.linalg.vector_norm(way, dim=1).mean() for way in ways]).sum()


def smoothness(flow_m: Tensor, neighbours: Tensor) -> Tensor:
    """Mean L1 difference between the flow of each point and of its neighbours.

    Args:
        flow_m: (N, 3).
        neighbours: (N, k) indices; the point itself may be among them, and counts.
    """
    apart: Tensor = (flow_m[neighbours] - flow_m[:, None]).abs().sum(dim=2)
    return apart.mean()


def nearest_neighbours(points_m: Tensor, count: int, *, radius_m: float) -> Tensor:
    """Find the nearest points of each, itself first; those beyond the radius become the nearest.

    Returns:
        (N, count) int64, of equally near points the lower index first.
    """
    found = _nearest(points_m, points_m, count)
    apart = torch.linalg.vector_norm(points_m[found] - points_m[:, None], dim=2)
    return torch.where(apart > radius_m, found[:, :1], found)


def ball_neighbours(points_m: Tensor, count: int, *, radius_m: float) -> Tensor:
    """Find the first points, by index, nearer than the radius; where fewer are, the first again.

    Returns:
        (N, count) int64.
    """
    rows = []
    n = len(points_m)
    index = torch.arange(n, device=points_m.device)
    for block in _blocks(points_m):
        inside = _squared(block, points_m) < radius_m**2
        first = torch.where(inside, index, n).topk(min(count, n), largest=False, sorted=True).values
        if first.shape[1] < count:
            first = torch.cat((first, first.new_full((len(first), count - first.shape[1]), n)), 1)
        rows.append(torch.where(first == n, first[:, :1], first))
    return torch.cat(rows)


def _nearest(points_m: Tensor, other_points_m: Tensor, count: int) -> Tensor:
    """(N, count) indices of the nearest others, sorted; of equally near ones the lower first."""
    rows = []
    for block in _blocks(points_m):
        squared = _squared(block, other_points_m)
        rows.append(
            squared.argmin(dim=1, keepdim=True)
            if count == 1
            else squared.sort(dim=1, stable=True).indices[:, :count]
        )
    return torch.cat(rows)


def _blocks(points_m: Tensor) -> Iterator[Tensor]:
    for start in range(0, len(points_m), _BLOCK):
        yield points_m.detach()[start : start + _BLOCK]


def _squared(points_m: Tensor, other_points_m: Tensor) -> Tensor:
    """(N, M) squared distances by differences: the expanded form loses millimetres far out."""
    others = other_points_m.detach()
    total = torch.zeros(len(points_m), len(others), device=others.device, dtype=others.dtype)
    for axis in range(3):
        total += (points_m[:, None, axis] - others[None, :, axis]) ** 2
    return total
