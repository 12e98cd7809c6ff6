"""Scenery builder: collects the objects along a road and places all of them at once."""

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Floats, Mesh, box
from workers.lab.simulation.world.motion_along_road import Road
from workers.lab.simulation.world.street_kinds import Place
from workers.lab.simulation.world.terrain import Terrain


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The roads of a street and their ground.

    Attributes:
        roads: Each with its kind and the interval of path lengths with scenery.
        terrain: The ground.
    """

    roads: tuple[tuple[Road, Place, float, float], ...]
    terrain: Terrain
    _trees: list[cKDTree] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        """Build a spatial index of the roads."""
        for road, _, _, _ in self.roads:
            self._trees.append(cKDTree(np.stack([road.x_m[::2], road.y_m[::2]], axis=1)))

    def free_of_roads(
        self, x_m: Floats, y_m: Floats, *, beyond_m: float, but: int
    ) -> NDArray[np.bool_]:
        """Test which places are at least this far beyond the kerbs of all roads but one."""
        free = np.ones(len(x_m), dtype=np.bool_)
        places = np.stack([x_m, y_m], axis=1)
        for number, (_, place, _, _) in enumerate(self.roads):
            if number != but:
                reach = place.kerb_m + beyond_m
                away, _ = self._trees[number].query(places, distance_upper_bound=reach)
                free &= np.isinf(away)
        return free


@dataclass(frozen=True, slots=True)
class _Placement:
    along_m: float
    across_m: float
    turned_rad: float
    scale: tuple[float, float, float]
    sunk_m: float


class Builder:
    """Collects the objects along one road and places all of them at once."""

    def __init__(
        self, network: Network, number: int, green: float, rng: np.random.Generator
    ) -> None:
        self.network, self.number, self.green, self.rng = network, number, green, rng
        self.road, self.place, _, _ = network.roads[number]
        self.whole: list[Mesh] = []
        self._put: dict[int, tuple[Mesh, list[_Placement]]] = {}
        _, _, low, high = network.roads[number]
        self._free_at: dict[tuple[float, float], NDArray[np.bool_]] = {}
        self._steps = np.arange(low - 40.0, high + 40.0)

    def free(self, along_m: float, across_m: float, beyond_m: float = 0.5) -> bool:
        """Test whether a place along this road is on no other road; to the metre."""
        key = (round(across_m), beyond_m)
        if key not in self._free_at:
            x, y, _ = self.road.place(self._steps, np.full_like(self._steps, key[0]))
            self._free_at[key] = self.network.free_of_roads(
                x, y, beyond_m=beyond_m, but=self.number
            )
        at = round(along_m - self._steps[0])
        return bool(self._free_at[key][min(max(at, 0), len(self._steps) - 1)])

    def put(
        self,
        mesh: Mesh,
        along_m: float,
        across_m: float,
        *,
        turned_rad: float = 0.0,
        scale: float | tuple[float, float, float] = 1.0,
        sunk_m: float = 0.0,
    ) -> None:
        """Put a mesh at a roadside place, on the ground."""
        three = scale if isinstance(scale, tuple) else (scale, scale, scale)
        _, places = self._put.setdefault(id(mesh), (mesh, []))
        places.append(_Placement(along_m, across_m, turned_rad, three, sunk_m))

    def block(
        self,
        size_m: tuple[float, float, float, float],
        what: StreetClass,
        material: Material,
        along_m: float,
        across_m: float,
    ) -> None:
        """Put a box of this length, width, low and high at a roadside place."""
        length, width, low, high = size_m
        scale = (length, width, high - low)
        self.put(_unit_box(what, material), along_m, across_m, scale=scale, sunk_m=-low)

    def meshes(self) -> list[Mesh]:
        """Return all collected meshes in world space."""
        placed = list(self.whole)
        for mesh, puts in self._put.values():
            along, across = np.array([(p.along_m, p.across_m) for p in puts]).T
            x, y, heading = self.road.place(along, across)
            yaw = heading + np.array([p.turned_rad for p in puts])
            z = self.network.terrain.slope_m(x, y) - np.array([p.sunk_m for p in puts])
            scaled = mesh.corners_m[None] * np.array([p.scale for p in puts])[:, None]
            cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
            corners = np.stack(
                [
                    cos * scaled[..., 0] - sin * scaled[..., 1] + x[:, None],
                    sin * scaled[..., 0] + cos * scaled[..., 1] + y[:, None],
                    scaled[..., 2] + z[:, None],
                ],
                axis=-1,
            )
            shift = np.arange(len(puts))[:, None, None] * len(mesh.corners_m)
            placed.append(
                Mesh(
                    corners.reshape(-1, 3),
                    (mesh.triangles[None] + shift).reshape(-1, 3).astype(np.int32),
                    np.tile(mesh.class_id, len(puts)),
                    np.tile(mesh.material, len(puts)),
                )
            )
        return placed


@cache
def _unit_box(what: StreetClass, material: Material) -> Mesh:
    return box(1.0, 1.0, 0.0, 1.0, what=what, material=material)
