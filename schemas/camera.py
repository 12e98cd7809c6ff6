"""Camera calibration, for streams that compare only points in a camera's view."""

from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Finite

_Four = tuple[Finite, Finite, Finite, Finite]
Matrix34 = tuple[_Four, _Four, _Four]
Matrix44 = tuple[_Four, _Four, _Four, _Four]

MAX_PIXELS: Final = 1_000_000
"""Maximum width and height of an image, pixels."""

RECORDED: Final = "recorded"
"""Value of the setting `camera` that takes the calibration recorded in the log."""


class CameraCalibration(BaseModel):
    """Projection of lidar points into an undistorted image."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    pixel_from_camera: Matrix34 = Field(description="Projection to pixels, KITTI's `P2`.")
    camera_from_lidar: Matrix44 = Field(
        description="Sensor space of the lidar to the camera's: x right, y down, z ahead; metres."
    )
    width: int = Field(gt=0, le=MAX_PIXELS, description="Of the image, pixels.")
    height: int = Field(gt=0, le=MAX_PIXELS, description="Of the image, pixels.")
    rectified_from_camera: Matrix44 | None = Field(
        default=None,
        description="Rotation that the projection expects, KITTI's `R0_rect`; the published code "
        "leaves it out.",
    )

    @classmethod
    def of(
        cls,
        pixel_from_camera: NDArray[np.floating],
        camera_from_lidar: NDArray[np.floating],
        *,
        width: int,
        height: int,
    ) -> Self:
        """Make a calibration from a (3, 4) and a (4, 4) array.

        Raises:
            ValueError: If the shapes differ, or a number is not finite.
        """
        return cls.model_validate(
            {
                "pixel_from_camera": pixel_from_camera.tolist(),
                "camera_from_lidar": camera_from_lidar.tolist(),
                "width": width,
                "height": height,
            }
        )

    @property
    def projection(self) -> NDArray[np.float64]:
        """(3, 4) `pixel_from_camera`."""
        return np.array(self.pixel_from_camera, dtype=np.float64)

    @property
    def extrinsics(self) -> NDArray[np.float64]:
        """(4, 4) `camera_from_lidar`."""
        return np.array(self.camera_from_lidar, dtype=np.float64)
