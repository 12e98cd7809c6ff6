"""FlowStep3D: learned scene flow by iterative refinement.

Source: Kittenplon, Eldar, Raviv, "FlowStep3D: Model Unrolling for Self-Supervised Scene Flow
Estimation", CVPR 2021, section 3; MIT code, published parameter names. Encoders as in PointNet++,
the global correlation as in FLOT (Puy et al., ECCV 2020). The flow embedding is as in FlowNet3D
(Liu et al., CVPR 2019), the updates by a gated recurrent unit as in RAFT (Teed, Deng, ECCV 2020).

Tensors: positions (B, N, 3) in metres, features (B, C, N). The published code searches
neighbourhoods again in every layer; here they are searched once. At one level, the nearest 4 of a
point are the first of its nearest 32, so the numbers are the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from workers.lidar.fidelity import Form
from workers.paper.point_sets import (
    find_nearest,
    gather_features,
    gather_points,
    interpolate,
    interpolation,
    sample_furthest,
    squared_distances,
)

_LEVELS = 5
_MAX_SHIFT_M = 10.0  # the first guess looks no farther for a partner, published
_SHARPEST = 0.03  # lower limit of the temperature of the first guess, published


class SetConv(nn.Module):
    """Encodes points by the features of their neighbours: shared layers, then max pooling.

    Args:
        inputs: Channels of the features; three are added for the offset of each neighbour.
        outputs: Channels of each layer.
        neighbours: Number of neighbours.
        act: Normalise and rectify after each layer. Without, the normalisation is stored but not
            used, as published.
    """

    def __init__(
        self, inputs: int, outputs: Sequence[int], *, neighbours: int, act: bool = True
    ) -> None:
        super().__init__()
        self.neighbours, self.act = neighbours, act
        widths = (inputs + 3, *outputs)
        self.mlp_convs = nn.ModuleList(
            nn.Conv2d(before, after, 1, bias=False) for before, after in pairwise(widths)
        )
        self.mlp_bns = nn.ModuleList(nn.BatchNorm2d(after) for after in outputs)

    def forward(self, positions: Tensor, features: Tensor, around: "Around") -> Tensor:
        """Encode the centres of neighbourhoods.

        Args:
            positions: (B, N, 3) points with features.
            features: (B, inputs, N).
            around: M neighbourhoods among these points.

        Returns:
            (B, outputs[-1], M).
        """
        index = around.index[:, :, : self.neighbours]
        way = gather_points(positions, index) - around.centres[:, :, None]
        grouped = torch.cat((way.permute(0, 3, 1, 2), gather_features(features, index)), dim=1)
        return self.describe(grouped)

    def describe(self, grouped: Tensor) -> Tensor:
        """Map (B, inputs + 3, M, neighbours) to (B, outputs[-1], M)."""
        for conv, norm in zip(self.mlp_convs, self.mlp_bns, strict=True):
            grouped = conv(grouped)
            if self.act:
                grouped = functional.relu(norm(grouped), inplace=not torch.is_grad_enabled())
        return grouped.amax(dim=3)


@dataclass(frozen=True, slots=True)
class Around:
    """Neighbourhoods of points.

    Attributes:
        centres: (B, M, 3).
        index: (B, M, K) int64 of the nearest points, nearest first.
    """

    centres: Tensor
    index: Tensor


def _around(centres: Tensor, points: Tensor, count: int) -> Around:
    return Around(centres, find_nearest(centres, points, count)[1])


class LocalEncoder(nn.Module):
    """Features of single surfaces, at half and a quarter of the points."""

    def __init__(self) -> None:
        super().__init__()
        self.sa1 = SetConv(3, (32, 32, 32), neighbours=32)
        self.sa2 = SetConv(32, (64, 64, 64), neighbours=32)

    def forward(self, levels: Sequence[Tensor]) -> Tensor:
        """Map positions of the cloud, its half and its quarter to (B, 64, quarter)."""
        cloud, half, quarter = levels
        features = self.sa1(cloud, cloud.transpose(1, 2), _around(half, cloud, 32))
        described: Tensor = self.sa2(half, features, _around(quarter, half, 32))
        return described


class GlobalEncoder(nn.Module):
    """Features of whole objects, down to one point in 32."""

    def __init__(self) -> None:
        super().__init__()
        self.sa1 = SetConv(64, (128, 128, 128), neighbours=32)
        self.sa2 = SetConv(128, (128, 128, 128), neighbours=24)
        self.sa3 = SetConv(128, (256, 256, 256), neighbours=16)

    def forward(self, levels: Sequence[Tensor], features: Tensor) -> Tensor:
        """Map positions, quarter down to the 32nd, and (B, 64, quarter), to (B, 256, 32nd)."""
        layers = (self.sa1, self.sa2, self.sa3)
        for layer, (points, chosen) in zip(layers, pairwise(levels), strict=True):
            features = layer(points, features, _around(chosen, points, layer.neighbours))
        return features


class GlobalCorrelation(nn.Module):
    """Initial estimate of the flow, from the feature correlation of distant parts of two clouds."""

    def __init__(self) -> None:
        super().__init__()
        self.epsilon = nn.Parameter(torch.zeros(1))
        self.sa1 = SetConv(3, (32, 32, 64), neighbours=16)
        self.sa2 = SetConv(64, (64, 64, 128), neighbours=16)

    def forward(
        self, levels: Sequence[Tensor], features: Tensor, others: Tensor, other_features: Tensor
    ) -> Tensor:
        """Compare the coarsest points of both clouds.

        Args:
            levels: Positions of the first cloud from the quarter down to the 32nd.
            features: (B, 256, 32nd) of the first cloud.
            others: (B, M, 3) coarsest points of the second cloud.
            other_features: (B, 256, M).

        Returns:
            (B, 128, quarter).
        """
        quarter, eighth, sixteenth, coarsest = levels
        alike = _unit(features).transpose(1, 2) @ _unit(other_features)
        near = squared_distances(coarsest, others) < _MAX_SHIFT_M**2
        matched = torch.exp((alike - 1.0) / (torch.exp(self.epsilon) + _SHARPEST)) * near
        partner = (matched @ others) / (matched.sum(dim=2, keepdim=True) + 1e-8)
        flow = (partner - coarsest).transpose(1, 2)
        flow = interpolate(flow, *interpolation(sixteenth, coarsest))
        flow = self.sa1(sixteenth, flow, _around(sixteenth, sixteenth, 16))
        flow = interpolate(flow, *interpolation(eighth, sixteenth))
        flow = self.sa2(eighth, flow, _around(eighth, eighth, 16))
        return interpolate(flow, *interpolation(quarter, eighth))


def _unit(features: Tensor) -> Tensor:
    return features / (features.square().sum(dim=1, keepdim=True) + 1e-8).sqrt()


class FlowEmbedding(SetConv):
    """Compares each moved point with the points of the other cloud around it.

    Args:
        neighbours: Number of compared points.
        radius_m: A farther neighbour is replaced by the nearest.
    """

    def __init__(self, *, neighbours: int, radius_m: float) -> None:
        super().__init__(128, (128, 128, 128), neighbours=neighbours)
        self.radius_m = radius_m

    def compare(
        self, moved: Tensor, features: Tensor, others: Tensor, other_features: Tensor
    ) -> Tensor:
        """Map (B, M, 3) and (B, 64, M), and those of the other cloud, to (B, 128, M)."""
        squared, index = find_nearest(moved, others, self.neighbours)
        index = torch.where(squared.sqrt() > self.radius_m, index[:, :, :1], index)
        way = (gather_points(others, index) - moved[:, :, None]).permute(0, 3, 1, 2)
        own = features[:, :, :, None].expand(-1, -1, -1, index.shape[2])
        return self.describe(torch.cat((way, gather_features(other_features, index), own), dim=1))


class HiddenStart(nn.Module):
    """Initial hidden state of the recurrent unit."""

    def __init__(self) -> None:
        super().__init__()
        self.sa1 = SetConv(64, (128, 128, 128), neighbours=8)
        self.sa2 = SetConv(128, (128,), neighbours=8, act=False)

    def forward(self, points: Tensor, features: Tensor, around: Around) -> Tensor:
        """Map (B, 64, M) to (B, 128, M), not yet squashed."""
        started: Tensor = self.sa2(points, self.sa1(points, features, around), around)
        return started


class Gru(nn.Module):
    """Gated recurrent unit over neighbourhoods of four."""

    def __init__(self) -> None:
        super().__init__()
        channels = 128 + 211
        self.convz = SetConv(channels, (128,), neighbours=4, act=False)
        self.convr = SetConv(channels, (128,), neighbours=4, act=False)
        self.convq = SetConv(channels, (128,), neighbours=4, act=False)

    def forward(self, hidden: Tensor, x: Tensor, points: Tensor, around: Around) -> Tensor:
        """Map the hidden state (B, 128, M) and the input (B, 211, M) to the new hidden state."""
        both = torch.cat((hidden, x), dim=1)
        update = torch.sigmoid(self.convz(points, both, around))
        reset = torch.sigmoid(self.convr(points, both, around))
        fresh = self.convq(points, torch.cat((reset * hidden, x), dim=1), around)
        return (1 - update) * hidden + update * torch.tanh(fresh)


class FirstRegressor(nn.Module):
    """Flow from the global correlation."""

    def __init__(self) -> None:
        super().__init__()
        self.sa1 = SetConv(128, (128, 128, 128), neighbours=32)
        self.fc = nn.Linear(128, 3)

    def forward(self, points: Tensor, features: Tensor, around: Around) -> Tensor:
        """Map (B, 128, M) to (B, 3, M), metres."""
        flow: Tensor = self.fc(self.sa1(points, features, around).transpose(1, 2))
        return flow.transpose(1, 2)


class Regressor(nn.Module):
    """Regresses a step of the flow from the hidden state."""

    def __init__(self) -> None:
        super().__init__()
        self.sa1 = SetConv(128, (128, 128, 128), neighbours=32)
        self.sa2 = SetConv(128, (128, 128, 128), neighbours=32)
        self.fc = nn.Linear(128, 3)

    def forward(self, points: Tensor, features: Tensor, around: Around) -> Tensor:
        """Map (B, 128, M) to (B, 3, M), metres."""
        features = self.sa2(points, self.sa1(points, features, around), around)
        step: Tensor = self.fc(features.transpose(1, 2))
        return step.transpose(1, 2)


class FlowStep3D(nn.Module):
    """The whole network.

    Args:
        points: Size of the training clouds; level `n` keeps `points / 2^n`.
        neighbours: Points of the second cloud that each moved point is compared with.
        radius_m: Largest distance of those points.
        decay: Step `i` of the flow is divided by `decay * i + 1`.
        form: Corrected: a cloud of fewer than `points` points is sampled as one of its own size, so
            that each level halves the one before; larger clouds are sampled as published. Paper:
            the levels have the sizes of `points` for any cloud; a cloud of less than half that size
            has points sampled twice.
    """

    def __init__(
        self,
        *,
        points: int = 8192,
        neighbours: int = 16,
        radius_m: float = 1.5,
        decay: float = 0.5,
        form: Form = Form.CORRECTED,
    ) -> None:
        super().__init__()
        self.points, self.decay, self.form = points, decay, form
        self.encoder_loc = LocalEncoder()
        self.encoder_glob = GlobalEncoder()
        self.global_corr_layer = GlobalCorrelation()
        self.h0_net = HiddenStart()
        self.flow0_regressor = FirstRegressor()
        self.flow_regressor = Regressor()
        self.local_corr_layer = FlowEmbedding(neighbours=neighbours, radius_m=radius_m)
        self.gru = Gru()
        self.flow_conv1 = SetConv(3, (32, 32, 32), neighbours=16)
        self.flow_conv2 = SetConv(32, (16, 16, 16), neighbours=8)

    def level_sizes(self, count: int) -> tuple[int, ...]:
        """Return the number of points in each of the five levels of a cloud of `count` points."""
        size = self.points if self.form is Form.PAPER else min(self.points, count)
        return tuple(max(1, size >> level) for level in range(1, _LEVELS + 1))

    def sample(self, cloud: Tensor) -> list[Tensor]:
        """Sample the points of each level, as indices into the level before it.

        Args:
            cloud: (B, N, 3).

        Returns:
            Five tensors (B, size) int64.
        """
        chosen: list[Tensor] = []
        for size in self.level_sizes(cloud.shape[1]):
            chosen.append(sample_furthest(cloud, size))
            cloud = gather_points(cloud, chosen[-1])
        return chosen

    def forward(self, cloud: Tensor, next_cloud: Tensor, *, iterates: int = 5) -> list[Tensor]:
        """Estimate the flow of each point.

        Args:
            cloud: (B, N, 3) float32 metres; x left, y up, z forward as published.
            next_cloud: (B, M, 3) the target cloud, in the same space.
            iterates: Number of estimates, the initial one included; 5 as published.

        Returns:
            Every estimate, (B, N, 3) metres, the last one best.

        Raises:
            ValueError: If a cloud is empty, or `iterates` is less than 1.
        """
        if iterates < 1 or min(cloud.shape[1], next_cloud.shape[1]) < 1:
            raise ValueError(
                f"flow needs points in both clouds and an iterate, got {cloud.shape[1]} and "
                f"{next_cloud.shape[1]} points, {iterates} iterates"
            )
        chosen = self.sample(cloud)
        levels, next_levels = _levels(cloud, chosen), _levels(next_cloud, self.sample(next_cloud))
        points, next_points = levels[2], next_levels[2]
        features = self.encoder_loc(levels[:3])
        next_features = self.encoder_loc(next_levels[:3])
        correlation = self.global_corr_layer(
            levels[2:],
            self.encoder_glob(levels[2:], features),
            next_levels[5],
            self.encoder_glob(next_levels[2:], next_features),
        )
        around = _around(points, points, 32)
        upsampling = interpolation(cloud, points)
        low_step = self.flow0_regressor(points, correlation, around)
        hidden = torch.tanh(self.h0_net(points, features, around))
        moved, low_moved = cloud, points
        flows = []
        for iterate in range(iterates):
            if iterate > 0:
                low_flow = (low_moved - points).transpose(1, 2)
                hidden = self._remember(
                    hidden,
                    (moved, chosen, low_moved, low_flow),
                    (next_points, next_features),
                    around,
                )
                low_step = self.flow_regressor(points, hidden, around)
                low_step = low_step / (self.decay * (iterate - 1) + 1)
            low_moved = low_moved + low_step.transpose(1, 2)
            moved = moved + interpolate(low_step, *upsampling).transpose(1, 2)
            flows.append(moved - cloud)
            moved, low_moved = moved.detach(), low_moved.detach()
        return flows

    def _remember(
        self,
        hidden: Tensor,
        now: tuple[Tensor, list[Tensor], Tensor, Tensor],
        then: tuple[Tensor, Tensor],
        around: Around,
    ) -> Tensor:
        """Compare the moved cloud with the next one, and update the hidden state."""
        moved, chosen, _, low_flow = now
        moved_levels = _levels(moved, chosen[:2])
        features = self.encoder_loc(moved_levels)
        compared = self.local_corr_layer.compare(moved_levels[2], features, *then)
        points = around.centres
        flow = self.flow_conv2(points, self.flow_conv1(points, low_flow, around), around)
        new = torch.cat((features, compared, flow, low_flow), dim=1)
        remembered: Tensor = self.gru(hidden, new, points, around)
        return remembered


def _levels(cloud: Tensor, chosen: Sequence[Tensor]) -> list[Tensor]:
    """Return the positions of a cloud and of its levels."""
    levels = [cloud]
    for index in chosen:
        levels.append(gather_points(levels[-1], index))
    return levels
