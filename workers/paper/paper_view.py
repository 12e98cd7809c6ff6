"""Compared points of a frame in the paper: visible to the camera, near, off GndNet's ground."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.arrays import Points
from schemas.camera import CameraCalibration
from schemas.errors import PermanentError
from schemas.frame import LidarFrame
from workers.checkpoints.stored_weights import Stored
from workers.lidar.fidelity import Form
from workers.paper.camera_filter import camera_filter, to_flow_space
from workers.paper.gndnet import GndNet
from workers.paper.ground_rule import ground_labels
from workers.paper.pillars import pillars
from workers.paper.weights import GndNetCard


class NoCameraError(PermanentError):
    """The log has no camera calibration, which the paper's view needs."""


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """Compared points of one frame.

    Attributes:
        ground: (N,) int8 of every point: -1 outside of GndNet's map, 0 ground, 1 not ground.
        kept: (K,) int64 rising indices of the points that are compared.
        points_m: (K, 3) float32 lidar's sensor space.
        flow_points_m: (K, 3) float32 the space of the flow: x left, y up, z ahead.
        calibration: The camera.
    """

    ground: NDArray[np.int8]
    kept: NDArray[np.int64]
    points_m: Points
    flow_points_m: Points
    calibration: CameraCalibration


class PaperView:
    """Selects the compared points of each frame, bug-compatible with the published code.

    Args:
        gndnet: Weights of GndNet, in the paper's form.
    """

    def __init__(self, gndnet: Stored[GndNet, GndNetCard]) -> None:
        self._height_m = gndnet.card.sensor_height_m
        self._net = gndnet.net.double()

    def compared(self, frame: LidarFrame) -> Compared:
        """Select the compared points of a frame.

        Raises:
            NoCameraError: If the frame has no camera's calibration.
        """
        calibration = frame.camera
        if calibration is None:
            raise NoCameraError(
                "the paper's chain compares what a camera sees: set camera to `recorded`, or to a "
                f"JSON file of the calibration ({frame.log_id})"
            )
        valid = np.flatnonzero(frame.valid_mask)
        points_m = frame.points_m[valid]
        ground = ground_labels(
            points_m,
            self.elevation(points_m, frame.intensity[valid]),
            lidar_height_m=self._height_m,
            form=Form.PAPER,
        )
        kept = camera_filter(points_m, ground, calibration, form=Form.PAPER).kept
        of_all = np.full(len(frame), -1, dtype=np.int8)
        of_all[valid] = ground
        chosen_m = points_m[kept]
        return Compared(
            of_all, valid[kept], chosen_m, to_flow_space(chosen_m, calibration), calibration
        )

    def elevation(self, points_m: Points, intensity: NDArray[np.float32]) -> NDArray[np.float32]:
        """Estimate the ground: (100, 100) metres over the road below the sensor, indexed [y, x].

        The network runs in double precision: with the statistics of one cloud, single precision
        differs by 7 cm between processors.
        """
        cut = pillars(points_m, intensity, lidar_height_m=self._height_m)
        with torch.inference_mode():
            answer: NDArray[np.float32] = (
                self._net(
                    torch.from_numpy(cut.points).double(),
                    torch.from_numpy(cut.counts.astype(np.int64)),
                    torch.from_numpy(cut.coordinates_zyx.astype(np.int64)),
                )
                .float()
                .numpy()
            )
        return answer
