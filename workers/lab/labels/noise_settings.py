"""Strength of label noise, and the frame on which it depends."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import Mask, Points, Transform
from workers.lab.labels.borders import Borders

STATIC: Final = 1
DYNAMIC: Final = 2

MotionCodes = NDArray[np.uint8]
ClassIds = NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Strength of each kind of noise.

    Attributes:
        bleed_m: Median width by which an object's label bleeds onto what is around it, metres.
        bleed_spread: Standard deviation of the logarithm of that width between objects.
        bleed_per_m: Growth of the width with the range of the object, per metre.
        ground_factor: Factor of the width on the ground, where bleeding is narrower.
        shadow_rad: Median width by which it bleeds onto what is behind its outline, radians.
        inside_m: Median width by which its border takes the label of the surroundings, metres.
        blobs_per_frame: Mean number of new blobs of a wrong class in a frame.
        blob_m: Least and largest radius of a blob, metres.
        blob_frames: Longest life of a blob, frames; shorter than any failure.
        blob_moving_share: Share of blobs that are labelled moving too.
        flicker_from_m: Range from which an object's motion flickers, metres.
        flicker_full_m: Range from which it flickers most.
        flicker_share: Largest share of frames in which a far mover is labelled static.
        late_share: Share of frames in which the label of a mover is that of the frame before.
        rest_frames: Frames of an object without flicker after a wrong one. Noise is then wrong on
            an object for less than half a second in any three, which is no failure.
        bleed_most_m: Largest width of bleeding; beyond half a metre it would be an object.
    """

    bleed_m: float = 0.2
    bleed_spread: float = 0.6
    bleed_per_m: float = 0.015
    ground_factor: float = 0.9
    shadow_rad: float = float(np.radians(0.2))
    inside_m: float = 0.07
    blobs_per_frame: float = 1.0
    blob_m: tuple[float, float] = (0.25, 1.0)
    blob_frames: int = 4
    blob_moving_share: float = 0.4
    flicker_from_m: float = 25.0
    flicker_full_m: float = 60.0
    flicker_share: float = 0.10
    late_share: float = 0.04
    rest_frames: int = 7
    bleed_most_m: float = 0.45


REAL: Final = NoiseSettings()
"""Noise of the size that networks show at borders and at range on real drives."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenFrame:
    """Points, objects and pose of one frame, on which the noise depends.

    Attributes:
        points_m: (N, 3) points in sensor space.
        thing: (N,) number of the object that a point belongs to, -1 none.
        ground: (N,) true on the ground.
        world_from_sensor: (4, 4) pose of the sensor in any world that rests.
        borders: Borders of its objects.
    """

    points_m: Points
    thing: NDArray[np.int64]
    ground: Mask
    world_from_sensor: Transform
    borders: Borders
