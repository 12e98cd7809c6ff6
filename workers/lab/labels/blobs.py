"""Blobs of a wrong class: parts of structure and ground that a model mistakes for a moment."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from workers.lab.labels.noise_settings import (
    DYNAMIC,
    ClassIds,
    MotionCodes,
    NoiseSettings,
    SeenFrame,
)

_BLOBS_APART_M: Final = 8.0
"""Least distance between moving blobs of the same second, metres; tracks join nearer ones."""


@dataclass(frozen=True, slots=True, eq=False)
class _Blob:
    world_m: NDArray[np.float64]
    radius_m: float
    last_frame: int
    class_id: int
    moving: bool


@dataclass(slots=True, eq=False)
class Blobs:
    """The blobs of one drive.

    Attributes:
        classes: Class ids that a blob may have.
        settings: Strength of the noise.
    """

    classes: Sequence[int]
    settings: NoiseSettings
    _alive: list[_Blob] = field(default_factory=list)

    def apply(
        self,
        seen: SeenFrame,
        count: int,
        motion: MotionCodes,
        class_id: ClassIds,
        rng: np.random.Generator,
    ) -> None:
        """Give the points of blobs a wrong class, in place; objects are spared.

        Args:
            seen: The frame.
            count: Number of the frame in the drive.
            motion: (N,) motion labels.
            class_id: (N,) classes.
            rng: Source of new blobs.
        """
        these = self.settings
        oldest = count - these.rest_frames
        self._alive = [each for each in self._alive if each.last_frame >= oldest]
        free = np.flatnonzero((seen.thing < 0) & (np.abs(seen.points_m).sum(axis=1) > 0))
        born = int(rng.poisson(these.blobs_per_frame)) if len(free) else 0
        pose = seen.world_from_sensor
        for _ in range(born):
            place_m = pose[:3, :3] @ seen.points_m[rng.choice(free)] + pose[:3, 3]
            moves = bool(rng.random() < these.blob_moving_share) and self._is_far(place_m)
            self._alive.append(
                _Blob(
                    world_m=place_m,
                    radius_m=float(rng.uniform(*these.blob_m)),
                    last_frame=count + int(rng.integers(these.blob_frames)),
                    class_id=int(rng.choice(self.classes)),
                    moving=moves,
                )
            )
        for each in self._alive:
            if each.last_frame < count:
                continue
            middle = (each.world_m - pose[:3, 3]) @ pose[:3, :3]
            away = seen.points_m - middle.astype(np.float32)
            mine = np.einsum("ij,ij->i", away, away) < each.radius_m**2
            mine &= seen.thing < 0
            class_id[mine] = each.class_id
            if each.moving:
                motion[mine] = DYNAMIC

    def _is_far(self, place_m: NDArray[np.float64]) -> bool:
        """Return True unless a moving blob is or was near: two in turn would last too long."""
        return all(
            float(np.linalg.norm(each.world_m - place_m)) > _BLOBS_APART_M
            for each in self._alive
            if each.moving
        )
