"""View of a picture from above: its window on the ground, and the transform between frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.overlay import Overlay


@dataclass(frozen=True, slots=True)
class View:
    """A square window on the ground plane of one frame's sensor space, x upwards, y to the left.

    Attributes:
        frame: Index of the frame in the overlay.
        centre_m: Centre of the window, x and y, metres.
        half_m: Half of its side, metres.
        size_px: Pixels along a side.
    """

    frame: int
    centre_m: tuple[float, float]
    half_m: float
    size_px: int

    @property
    def px_per_m(self) -> float:
        """Scale, pixels per metre."""
        return self.size_px / (2 * self.half_m)

    def to_px(self, points_m: NDArray[np.floating]) -> NDArray[np.float64]:
        """Map (N, 2 or more) sensor space to (N, 2) pixels, x right and y down."""
        x = self.size_px / 2 - (points_m[:, 1] - self.centre_m[1]) * self.px_per_m
        y = self.size_px / 2 - (points_m[:, 0] - self.centre_m[0]) * self.px_per_m
        return np.stack([x, y], axis=1).astype(np.float64)


def to_frame(
    overlay: Overlay, points_m: NDArray[np.floating], *, of: int, to: int
) -> NDArray[np.float64]:
    """Map (N, 3) points from the sensor space of one frame of a scene to that of another."""
    to_from_of = np.linalg.inv(overlay.odom_from_sensor[to]) @ overlay.odom_from_sensor[of]
    return np.asarray(points_m @ to_from_of[:3, :3].T + to_from_of[:3, 3], dtype=np.float64)
