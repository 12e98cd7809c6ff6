"""Boxes that the model on the car recorded, as arrays in the space of the lidar."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import check_array, freeze


@dataclass(frozen=True, slots=True, eq=False)
class RecordedBoxes:
    """Boxes of one answer of the model, B of them, in the sensor's space at `stamp_ns`.

    Attributes:
        stamp_ns: Time of the boxes, by the clock of the lidar's stamps.
        centre_m: (B, 3) float64 centres, metres.
        size_m: (B, 3) float64 length, width, height, metres, all positive.
        sensor_from_box: (B, 3, 3) float64 rotations; x of a box is along its length.
        velocity_m_per_s: (B, 3) float64 velocity over the ground, along the sensor's axes; NaN
            where the model states none.
        score: (B,) float64 0 to 1; NaN where the model states none.
        class_name: Class of each box by its name, as recorded; empty: none.
        track_id: The model's own identity of each box over time; empty: none.
        movable: Whether each class can move; None where no mapping knows it.
        moving: Whether each class means that it moves.

    Raises:
        ValueError: If lengths differ or an array has the wrong type.
    """

    stamp_ns: int
    centre_m: NDArray[np.float64]
    size_m: NDArray[np.float64]
    sensor_from_box: NDArray[np.float64]
    velocity_m_per_s: NDArray[np.float64]
    score: NDArray[np.float64]
    class_name: tuple[str, ...]
    track_id: tuple[str, ...]
    movable: tuple[bool | None, ...]
    moving: tuple[bool, ...]

    def __post_init__(self) -> None:
        """Check every array once, and make it read-only."""
        n = len(self.centre_m)
        for name in ("centre_m", "size_m", "velocity_m_per_s"):
            check_array(name, getattr(self, name), shape=(n, 3), dtype=np.float64)
        check_array("sensor_from_box", self.sensor_from_box, shape=(n, 3, 3), dtype=np.float64)
        check_array("score", self.score, shape=(n,), dtype=np.float64)
        lengths = {len(self.class_name), len(self.track_id), len(self.movable), len(self.moving)}
        if lengths != {n}:
            raise ValueError(f"{n} boxes need as many classes, ids and meanings, got {lengths}")
        freeze(
            self.centre_m,
            self.size_m,
            self.sensor_from_box,
            self.velocity_m_per_s,
            self.score,
        )

    def __len__(self) -> int:
        """Count the boxes."""
        return len(self.centre_m)
