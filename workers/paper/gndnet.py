"""GndNet: learned ground elevation on a grid of 1 m cells, from pillars of points.

Source: Paigwar, Erkent, Sierra-Gonzalez, Laugier, "GndNet: Fast Ground Plane Estimation and Point
Cloud Segmentation for Autonomous Vehicles", IROS 2020, section III; MIT code, published parameter
names. Pillars as in PointPillars (Lang et al., CVPR 2019), the head as in SegNet.
"""

from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from workers.lidar.fidelity import Form
from workers.paper.pillars import GNDNET_GRID

GRID: Final = GNDNET_GRID.shape
"""Cells of the elevation map along y and x, published."""

CELL_M: Final = GNDNET_GRID.side_m
GRID_ORIGIN_M: Final = (GNDNET_GRID.x_m[0], GNDNET_GRID.y_m[0])
"""Lower edge of the grid in x and y, sensor space, published."""

POINT_CHANNELS: Final = 4
"""x, y, z over the ground (metres) and intensity (0 to 1)."""

_ENCODING: Final = 64


class PfnLayer(nn.Module):
    """One linear layer over points, then the maximum of each pillar."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.linear = nn.Linear(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Map (M, P, inputs) to (M, outputs)."""
        encoded: Tensor = torch.relu(self.linear(x)).amax(dim=1)
        return encoded


class PillarEncoder(nn.Module):
    """Encodes each point within its pillar, and each pillar by its points."""

    def __init__(self) -> None:
        super().__init__()
        self.pfn_layers = nn.ModuleList([PfnLayer(POINT_CHANNELS + 5, _ENCODING)])

    def forward(self, pillars: Tensor, points_in_pillar: Tensor, coords_zyx: Tensor) -> Tensor:
        """Map pillars to (M, 64); arguments as of `GndNet.forward`."""
        encoded: Tensor = self.pfn_layers[0](decorate(pillars, points_in_pillar, coords_zyx))
        return encoded


def decorate(pillars: Tensor, points_in_pillar: Tensor, coords_zyx: Tensor) -> Tensor:
    """Append to each point its offsets from the mean and the middle of its pillar.

    Places without a point stay zero; the layer after this gives them its bias, published.

    Args:
        pillars: (M, P, 4), zero where there is no point.
        points_in_pillar: (M,) number of points.
        coords_zyx: (M, 3) the cell of each pillar.

    Returns:
        (M, P, 9): the point, xyz from the mean, xy from the middle of the cell.
    """
    count = points_in_pillar.to(pillars.dtype)[:, None, None]
    mean = pillars[:, :, :3].sum(dim=1, keepdim=True) / count
    origin = pillars.new_tensor(GRID_ORIGIN_M)
    middle = coords_zyx.to(pillars.dtype)[:, [2, 1]] * CELL_M + (CELL_M / 2 + origin)
    parts = (pillars, pillars[:, :, :3] - mean, pillars[:, :, :2] - middle[:, None])
    place = torch.arange(pillars.shape[1], device=pillars.device)
    filled = place[None, :, None] < points_in_pillar[:, None, None]
    return torch.cat(parts, dim=2) * filled


class ConvBnRelu(nn.Module):
    """Convolution, batch normalisation, ReLU."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.outputs = outputs
        self.cbr_unit = nn.Sequential(
            nn.Conv2d(inputs, outputs, 3, padding=1), nn.BatchNorm2d(outputs), nn.ReLU()
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, inputs, H, W) to (B, outputs, H, W)."""
        out: Tensor = self.cbr_unit(x)
        return out


class BatchStatistics(nn.BatchNorm2d):
    """Batch normalisation by the statistics of the current batch in every mode; learns nothing."""

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to the same."""
        return functional.batch_norm(
            x, None, None, self.weight, self.bias, training=True, eps=self.eps
        )


class Down(nn.Module):
    """Two convolutions, then max pooling with the indices of the maxima."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv1 = ConvBnRelu(inputs, outputs)
        self.conv2 = ConvBnRelu(outputs, outputs)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Map (B, inputs, H, W) to (B, outputs, H / 2, W / 2) and the places of the maxima."""
        halved, places = functional.max_pool2d(
            self.conv2(self.conv1(x)), 2, stride=2, return_indices=True
        )
        return halved, places


class Up(nn.Module):
    """Max unpooling with stored indices, then two convolutions."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv1 = ConvBnRelu(inputs, inputs)
        self.conv2 = ConvBnRelu(inputs, outputs)

    def forward(self, x: Tensor, places: Tensor) -> Tensor:
        """Map (B, inputs, H, W) to (B, outputs, 2H, 2W)."""
        out: Tensor = self.conv2(self.conv1(functional.max_unpool2d(x, places, (2, 2))))
        return out


class SegNetHead(nn.Module):
    """Encoder and decoder over the map of pillars."""

    def __init__(self) -> None:
        super().__init__()
        self.down1 = Down(_ENCODING, 128)
        self.down2 = Down(128, 256)
        self.up2 = Up(256, 128)
        self.up1 = Up(128, 64)
        self.regressor = nn.Conv2d(64, 1, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, 64, H, W) to (B, 1, H, W)."""
        x, places1 = self.down1(x)
        x, places2 = self.down2(x)
        out: Tensor = self.regressor(self.up1(self.up2(x, places2), places1))
        return out


class GndNet(nn.Module):
    """The whole network: encodes pillars, scatters them to a map, regresses the ground elevation.

    Args:
        form: Corrected: normalises by the statistics of the training. Paper: the published pipeline
            never leaves training mode, so every batch normalisation uses mean and variance of the
            current cloud; the statistics of the training are not used.

    Where two of four neighbours are equally high, rounding decides the index of the maximum, and so
    the decoder's cell for the value. Cells without points then differ by centimetres between
    processors. In float64 (`net.double()`) the result is the same on all.
    """

    def __init__(self, *, form: Form = Form.CORRECTED) -> None:
        super().__init__()
        self.form = form
        self.voxel_feature_extractor = PillarEncoder()
        self.encoder_decoder = SegNetHead()
        if form is Form.PAPER:
            for module in self.modules():
                if isinstance(module, ConvBnRelu):
                    module.cbr_unit[1] = BatchStatistics(module.outputs)

    def forward(self, pillars: Tensor, points_in_pillar: Tensor, coords_zyx: Tensor) -> Tensor:
        """Estimate the ground of one cloud.

        Args:
            pillars: (M, P, 4) float32, x, y, z and intensity of up to P points of each pillar, zero
                where there is none; metres, z raised by the height of the sensor over the road.
            points_in_pillar: (M,) int64, number of points of each, 1 to P.
            coords_zyx: (M, 3) int64, the cell of each pillar; z is 0, no cell twice.

        Returns:
            (100, 100) height of the ground in the space of the points, metres, indexed [y, x].
        """
        encoded = self.voxel_feature_extractor(pillars, points_in_pillar, coords_zyx)
        rows, columns = GRID
        canvas = encoded.new_zeros(_ENCODING, rows * columns)
        canvas[:, coords_zyx[:, 1] * columns + coords_zyx[:, 2]] = encoded.t()
        elevation: Tensor = self.encoder_decoder(canvas.view(1, _ENCODING, rows, columns))
        return elevation[0, 0]
