"""Scene flow of FlowStep3D for nearby points, after ego-motion compensation."""

from pathlib import Path
from typing import Final, Self

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.arrays import Flow, Mask, Points, Transform
from workers.checkpoints.stored_weights import Stored
from workers.paper.flowstep3d import FlowStep3D
from workers.paper.point_sets import interpolate, interpolation
from workers.paper.weights import FlowStep3DCard, load_flowstep3d
from workers.points.se3 import transform

REACH_M: Final = 35.0
"""Reach to each side and ahead, metres, as in training; farther points get no flow."""

FLOW_AXES: Final = (1, 2, 0)
"""Axes of the network (x left, y up, z ahead) from those of a sensor (x ahead, y left, z up)."""

_SENSOR_AXES: Final = (2, 0, 1)


class FlowStep3DFlow:
    """A `SceneFlowSource` of FlowStep3D: the network estimates the flow beyond ego-motion.

    The published chain gives both clouds to the network as measured, so that it has to estimate
    ego-motion again, which odometry knows to a centimetre. Here the first cloud is first moved by
    ego-motion, and the network estimates the rest. A cloud of more points than those of the
    training is thinned to as many, since the sizes of neighbourhoods follow from their density.

    Args:
        stored: The network and its card.
    """

    def __init__(self, stored: Stored[FlowStep3D, FlowStep3DCard]) -> None:
        self._stored = stored

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Load the network from a folder of imported weights.

        Raises:
            WeightsUnusableError: If it is missing or damaged.
        """
        return cls(load_flowstep3d(folder / "flowstep3d.safetensors"))

    @property
    def version(self) -> str:
        """Digest of the weights, and the library that runs them."""
        return f"{self._stored.digest} torch=={torch.__version__.partition('+')[0]}"

    def __call__(
        self, points_m: Points, other_points_m: Points, other_from_this: Transform
    ) -> Flow:
        """Estimate the flow of each point; see `SceneFlowSource`."""
        torch.set_num_threads(1)  # a worker owns one core, and sums keep their order
        expected = transform(other_from_this, points_m).astype(np.float32)
        near, other_near = _is_near(expected), _is_near(other_points_m)
        beyond_m = np.zeros_like(expected)
        if near.any() and other_near.any():
            flow_m = self._beyond(_cloud(expected[near]), _cloud(other_points_m[other_near]))
            beyond_m[near] = flow_m[:, _SENSOR_AXES]
        flow: Flow = expected + beyond_m - points_m
        return flow

    @torch.inference_mode()
    def _beyond(self, cloud: torch.Tensor, other: torch.Tensor) -> NDArray[np.float32]:
        """Estimate (N, 3) flow at the density of the training, interpolated to the other points."""
        most = self._stored.card.points
        sample = _thinned(cloud, most)
        answers = self._stored.net(
            sample, _thinned(other, most), iterates=self._stored.card.iterates
        )
        flow = answers[-1]
        if sample.shape[1] < cloud.shape[1]:
            upsampling = interpolation(cloud, sample)
            flow = interpolate(flow.transpose(1, 2), *upsampling).transpose(1, 2)
        estimated: NDArray[np.float32] = flow[0].numpy()
        return estimated


def _is_near(points_m: Points) -> Mask:
    return np.asarray((np.abs(points_m[:, :2]) < REACH_M).all(axis=1))


def _cloud(points_m: Points) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(points_m[:, FLOW_AXES], dtype=np.float32))[None]


def _thinned(cloud: torch.Tensor, most: int) -> torch.Tensor:
    """Return at most so many points of (1, N, 3), evenly spaced in their order."""
    number = cloud.shape[1]
    if number <= most:
        return cloud
    return cloud[:, (torch.arange(most, dtype=torch.int64) * number) // most]
