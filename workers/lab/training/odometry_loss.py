"""Self-supervised loss of DeLORA, as published: point-to-plane plus plane-to-plane distance.

Source: Nubert, Khattak, Hutter, "Self-supervised Learning of LiDAR Odometry for Robotic
Applications", ICRA 2021, section III-D, and its code. Partners are searched without gradient.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

POINT_WEIGHT: Final = 1.0
"""Weight of the point-to-plane distance, published."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Points with normals.

    Attributes:
        points_m: (N, 3) float32, metres.
        normals: (N, 3) float32 of length 1.
    """

    points_m: Tensor
    normals: Tensor


@dataclass(frozen=True, slots=True, eq=False)
class AlignmentLoss:
    """The parts of a loss, scalars.

    Attributes:
        point_to_plane: Mean squared distance of a point to the plane of its partner, m^2.
        plane_to_plane: Mean squared difference of both normals.
        total: Their weighted sum.
    """

    point_to_plane: Tensor
    plane_to_plane: Tensor
    total: Tensor


def alignment_loss(this: Surface, following: Surface, this_from_next: Tensor) -> AlignmentLoss:
    """Compute how well a motion aligns the following surface with this one.

    Args:
        this: Surface of the first frame, which all points of the second find their partners in.
        following: Surface of the second frame.
        this_from_next: (4, 4) maps points of the second frame into the space of the first.
    """
    turn, shift = this_from_next[:3, :3], this_from_next[:3, 3]
    points = following.points_m @ turn.T + shift
    normals = following.normals @ turn.T
    partner = _partners(points, this.points_m)
    there, facing = this.points_m[partner], this.normals[partner]
    to_plane = ((points - there) * facing).sum(dim=1).square().mean()
    planes = (normals - facing).square().sum(dim=1).mean()
    return AlignmentLoss(to_plane, planes, POINT_WEIGHT * to_plane + planes)


def identity_loss(this_from_next: Tensor) -> Tensor:
    """Return the mean squared difference of (B, 4, 4) motions to none; the first epoch fits it."""
    identity = torch.eye(4, dtype=this_from_next.dtype, device=this_from_next.device)
    return (this_from_next - identity).square().mean()


def _partners(points_m: Tensor, others_m: Tensor) -> Tensor:
    """(N,) indices of the nearest others."""
    queries = points_m.detach().cpu().numpy()
    _, nearest = cKDTree(others_m.cpu().numpy()).query(queries)
    return torch.from_numpy(nearest.astype(np.int64)).to(points_m.device)
