"""Camera picture of an overlay: an image kept when the scene was mined, and its calibration."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Transform, check_array, freeze
from schemas.bounds import MAX_TOPIC

MEDIA_TYPES: Final = frozenset({"image/jpeg", "image/png"})
"""Media types of pictures, which every browser shows."""

MAX_PICTURES: Final = 1024
"""Pictures of an overlay at most."""

MAX_SIDE_PX: Final = 32_768
"""Largest width and height of a picture, pixels."""


MAX_COEFFICIENTS: Final = 64
"""Coefficients of a lens at most; the models that are known have 4 to 14."""

MAX_MODEL: Final = 64
"""Characters of the name of a lens model."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One camera image of a scene, and the projection of the points of its frame into it.

    Attributes:
        topic: MCAP topic of the camera's images.
        frame: Index of the frame that it belongs to.
        stamp_ns: Of the image, nanoseconds since the Unix epoch.
        width: Pixels of the kept image.
        height: Pixels of the kept image.
        media_type: One of `MEDIA_TYPES`.
        image_bytes: The image, compressed.
        pixel_from_camera: (3, 4) projection, scaled to the kept image.
        camera_from_lidar: (4, 4) the sensor space of its frame to the camera's (x right, y down, z
            ahead).
        distortion_model: ROS's name; used only where `distortion` is not empty.
        distortion: Coefficients of the lens; empty for a rectified image.
        tracks: Numbers of the tracks that it sees.

    Raises:
        ValueError: If it has another media type, no size, or numbers that no camera has.
    """

    topic: str
    frame: int
    stamp_ns: int
    width: int
    height: int
    media_type: str
    image_bytes: bytes
    pixel_from_camera: NDArray[np.float64]
    camera_from_lidar: Transform
    distortion_model: str = ""
    distortion: tuple[float, ...] = ()
    tracks: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Check it once, and make its arrays read-only."""
        if self.media_type not in MEDIA_TYPES:
            raise ValueError(f"a picture is one of {sorted(MEDIA_TYPES)}, not {self.media_type!r}")
        if not (0 < self.width <= MAX_SIDE_PX and 0 < self.height <= MAX_SIDE_PX):
            raise ValueError(
                f"a picture has sides of 1 to {MAX_SIDE_PX} pixels, not {self.width} x "
                f"{self.height}"
            )
        if not 0 < len(self.topic) <= MAX_TOPIC or len(self.distortion_model) > MAX_MODEL:
            raise ValueError("the topic or the lens model of a picture has no name, or a long one")
        if len(self.distortion) > MAX_COEFFICIENTS:
            raise ValueError(f"a lens has at most {MAX_COEFFICIENTS} coefficients")
        check_array("pixel_from_camera", self.pixel_from_camera, shape=(3, 4), dtype=np.float64)
        check_array("camera_from_lidar", self.camera_from_lidar, shape=(4, 4), dtype=np.float64)
        numbers = (*self.pixel_from_camera.ravel(), *self.camera_from_lidar.ravel())
        if not np.isfinite((*numbers, *self.distortion)).all():
            raise ValueError("the calibration of a picture has numbers that are not finite")
        freeze(self.pixel_from_camera, self.camera_from_lidar)
