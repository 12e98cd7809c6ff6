"""Odometry of the paper: DeLORA estimates the motion between consecutive frames."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray

from schemas.arrays import Mask, Points
from schemas.frame import LidarFrame, PosedFrame
from workers.checkpoints.stored_weights import Stored
from workers.lidar.range_image import SensorProfile, project
from workers.paper.delora import DeLORA
from workers.paper.weights import DeLORACard, load_delora
from workers.part_version import release, version_of
from workers.points.se3 import transform


class DeLORAOdometry:
    """Poses composed of the network's motion of each pair of frames.

    The published chain projects twice, to an image of 2,250 columns and from that to 720; here
    once. The network reports no confidence, so every pose is healthy. Where the card names
    refinements, the second scan is moved by the motion of the frame before, and the network
    estimates what that leaves, as often as named.

    Args:
        weights: Weights of DeLORA.
    """

    def __init__(self, weights: Stored[DeLORA, DeLORACard]) -> None:
        self._weights = weights
        card = weights.card
        self._refinements = card.refinements
        self._profile = SensorProfile(
            name="delora",
            rows=card.rows,
            columns=card.columns,
            fov_up_deg=card.fov_up_deg,
            fov_down_deg=card.fov_down_deg,
        )

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Load the network from a folder of imported weights.

        Raises:
            WeightsUnusableError: If it is missing or damaged.
        """
        return cls(load_delora(folder / "delora.safetensors"))

    @property
    def version(self) -> str:
        """`delora@digest` of code, libraries and weights."""
        return version_of("delora", f"{self._weights.digest} torch=={release('torch')}")

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        """Yield each frame with its pose, in order; the first is the origin."""
        torch.set_num_threads(1)  # a worker owns one core, and sums keep their order
        odom_from_sensor, motion = np.eye(4), np.eye(4)
        before: torch.Tensor | None = None
        for frame in frames:
            if before is not None:
                motion = self._motion(before, frame, motion)
                odom_from_sensor = odom_from_sensor @ motion
            before = torch.from_numpy(self.image(frame))[None]
            yield PosedFrame(frame, odom_from_sensor.copy())

    def _motion(
        self, before: torch.Tensor, frame: LidarFrame, last: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Estimate the motion to a frame, (4, 4), from the image and the motion before it."""
        motion = last if self._refinements else np.eye(4)
        for _ in range(max(self._refinements, 1)):
            image = torch.from_numpy(self.image(frame, motion if self._refinements else None))[None]
            motion = self._estimate(before, image) @ motion
        return motion

    def _estimate(self, before: torch.Tensor, image: torch.Tensor) -> NDArray[np.float64]:
        """Estimate the motion between two images, (4, 4); with refinements the mean of both ways.

        An error that does not depend on the order of the images would add up over refinements.
        """
        if not self._refinements:
            with torch.inference_mode():
                found = self._weights.net(before, image).this_from_next.numpy()
            return _rigid(found[0].astype(np.float64))
        with torch.inference_mode():
            both = self._weights.net(torch.cat((before, image)), torch.cat((image, before)))
        there, back = both.this_from_next.numpy().astype(np.float64)
        return _rigid((there + np.linalg.inv(back)) / 2)

    def image(
        self, frame: LidarFrame, motion: NDArray[np.float64] | None = None
    ) -> NDArray[np.float32]:
        """Project a frame to the network's input.

        Args:
            frame: The frame.
            motion: (4, 4) moves its points before; None: they are projected as measured.

        Returns:
            (4, H, W) x, y, z and range, metres, zero where empty.
        """
        points_m = frame.points_m if motion is None else transform(motion, frame.points_m)
        return image_of(points_m, self._profile, valid_mask=frame.valid_mask)[0]


def image_of(
    points_m: Points, profile: SensorProfile, *, valid_mask: Mask | None = None
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Project points to the network's input.

    Returns:
        (4, H, W) x, y, z and range, metres, zero where empty; and (H, W) point of each pixel, -1
        where empty.
    """
    image = project(points_m, profile, valid_mask=valid_mask)
    shown = image.index[image.seen_mask]
    channels = np.zeros((4, *image.index.shape), np.float32)
    channels[:3, image.seen_mask] = points_m[shown].T
    channels[3, image.seen_mask] = image.point_range_m[shown]
    return channels, image.index


def _rigid(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Project a single-precision rotation to SO(3), so that poses of long logs stay rigid."""
    left, _, right = np.linalg.svd(matrix[:3, :3])
    rigid = matrix.copy()
    rigid[:3, :3] = left @ right
    return rigid
