"""Road map: class and material of the ground at a hit: carriageway, markings, or terrain."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.world.motion_along_road import Road

Floats = NDArray[np.float64]

_STEP_M: Final = 1.5
_MARKING_HALF_M: Final = 0.08


@dataclass(frozen=True, slots=True, eq=False)
class RoadMap:
    """Distances of a grid of places to the edge and the middle of the nearest road.

    Attributes:
        west_m: World x of the first column.
        south_m: World y of the first row.
        beyond_m: (X, Y) distance to the edge, negative on the carriageway.
        inner_m: (X, Y) distance to the middle of the nearest road.
        marks_m: Distances of lane markings from the middle.
    """

    west_m: float
    south_m: float
    beyond_m: NDArray[np.float32]
    inner_m: NDArray[np.float32]
    marks_m: tuple[float, ...]

    @classmethod
    def of(
        cls,
        roads: Sequence[tuple[Road, float]],
        bounds_m: tuple[float, float, float, float],
        marks_m: Sequence[float] = (),
    ) -> Self:
        """Compute the distances once.

        Args:
            roads: Each with half the width of its carriageway.
            bounds_m: West, south, east and north of the grid.
            marks_m: Distances of lane markings from the middle of a road.
        """
        west, south, east, north = bounds_m
        x, y = np.arange(west, east + _STEP_M, _STEP_M), np.arange(south, north + _STEP_M, _STEP_M)
        places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        beyond = np.full(places.shape[:2], np.inf, dtype=np.float32)
        inner = np.full(places.shape[:2], np.inf, dtype=np.float32)
        for road, half_width in roads:
            tree = cKDTree(np.stack([road.x_m, road.y_m], axis=1))
            away, _ = tree.query(places, distance_upper_bound=half_width + 8.0)
            inner = np.where(away - half_width < beyond, away, inner).astype(np.float32)
            beyond = np.minimum(beyond, away - half_width).astype(np.float32)
        return cls(west, south, np.minimum(beyond, 8.0), np.minimum(inner, 99.0), tuple(marks_m))

    def ground_at(self, x_m: Floats, y_m: Floats) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Return (N,) class and (N,) material of the ground at these places."""
        on_road = self._at(self.beyond_m, x_m, y_m) < 0.0
        class_id = np.where(on_road, StreetClass.ROAD, StreetClass.TERRAIN).astype(np.uint8)
        material = np.where(on_road, Material.ASPHALT, Material.GRASS).astype(np.uint8)
        if self.marks_m:
            inner = self._at(self.inner_m, x_m, y_m)
            marked = np.zeros(len(inner), dtype=np.bool_)
            for mark in self.marks_m:
                marked |= np.abs(inner - mark) < _MARKING_HALF_M
            material[on_road & marked] = Material.MARKING
        return class_id, material

    def _at(self, values: NDArray[np.float32], x_m: Floats, y_m: Floats) -> NDArray[np.float32]:
        x = np.clip((x_m - self.west_m) / _STEP_M, 0.0, values.shape[0] - 1.001)
        y = np.clip((y_m - self.south_m) / _STEP_M, 0.0, values.shape[1] - 1.001)
        i, j = x.astype(np.int64), y.astype(np.int64)
        u, v = (x - i).astype(np.float32), (y - j).astype(np.float32)
        low = values[i, j] * (1 - u) + values[i + 1, j] * u
        high = values[i, j + 1] * (1 - u) + values[i + 1, j + 1] * u
        return np.asarray(low * (1 - v) + high * v)
