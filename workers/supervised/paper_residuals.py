"""Residual images of the published loader: one per past frame, regardless of its age."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Points, Transform
from schemas.frame import PosedFrame
from workers.lidar.fidelity import Form
from workers.lidar.range_image import RangeImage, SensorProfile, project
from workers.points.se3 import inverse, transform
from workers.supervised.residual_image import ResidualSettings, residual_image


class PaperResiduals:
    """A ring of the last frames, each compared with the current one.

    `ResidualHistory` is the corrected form; it differs in this:

    - its channels are ages in seconds, here counts of frames, so that a sensor at 20 Hz, or a
      dropped frame, gives residuals unlike the training data;
    - its current frame is the network's input image, here a separate gated one, so that points
      hidden behind returns of the own car are compared.

    Args:
        profile: Layout of the image.
        settings: The range gate, and one age per compared frame; the values of the ages are not
            used.
    """

    def __init__(
        self,
        profile: SensorProfile,
        settings: ResidualSettings | None = None,
    ) -> None:
        self._profile = profile
        self._settings = settings or ResidualSettings()
        self._count = len(self._settings.ages_s)
        self._past: deque[tuple[Transform, Points]] = deque(maxlen=self._count)

    def compare(self, posed: PosedFrame, image: RangeImage) -> tuple[NDArray[np.float32], int]:
        """Compare a frame with those before it, then store it.

        Args:
            posed: The frame.
            image: Not used: the published loader projects its own.

        Returns:
            The result of `__call__`, and the number of past frames.
        """
        there = len(self._past)
        frame = posed.frame
        return self(frame.points_m[frame.valid_mask], posed.odom_from_sensor), there

    def __call__(self, points_m: Points, odom_from_sensor: Transform) -> NDArray[np.float32]:
        """Compare a frame with those before it, then store it.

        Args:
            points_m: (N, 3) valid points, sensor space, metres.
            odom_from_sensor: (4, 4) pose of the frame.

        Returns:
            (K, H, W) float32, the youngest past frame first; zero without one.
        """
        settings, profile = self._settings, self._profile
        image = project(
            points_m,
            profile,
            gate_m=(settings.min_range_m, settings.max_range_m),
            form=Form.PAPER,
        )
        residuals = np.zeros((self._count, *image.range_m.shape), dtype=np.float32)
        sensor_from_odom = inverse(odom_from_sensor)
        for channel, (odom_from_past, past_m) in zip(residuals, self._past, strict=False):
            moved = transform(sensor_from_odom @ odom_from_past, past_m)
            channel[:] = residual_image(image, moved, profile, settings)
        self._past.appendleft((odom_from_sensor, points_m))
        return residuals
