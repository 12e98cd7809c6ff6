"""What stands along streets: fronts, pavements, fences, rails, trees, poles, signs, bumps."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workers.simulation.drive import Road
from workers.simulation.kinds import Material, StreetClass
from workers.simulation.meshes import Floats, Mesh, box, grid, limb
from workers.simulation.places import Place
from workers.simulation.plants import SORTS, bush, grass, hedge, tree
from workers.simulation.terrain import BUMP_HALF_M, Terrain, bump_profile

KERB_HIGH_M: Final = 0.14


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The roads of a street and the ground they lie on.

    Attributes:
        roads: Each with its kind and the stretch of it that is built along.
        terrain: The ground.
    """

    roads: tuple[tuple[Road, Place, float, float], ...]
    terrain: Terrain
    _trees: list[cKDTree] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        """Index the roads by place."""
        for road, _, _, _ in self.roads:
            self._trees.append(cKDTree(np.stack([road.x_m[::2], road.y_m[::2]], axis=1)))

    def free_of_roads(
        self, x_m: Floats, y_m: Floats, *, beyond_m: float, but: int
    ) -> NDArray[np.bool_]:
        """Say which places lie at least so far beyond the kerbs of all roads but one."""
        free = np.ones(len(x_m), dtype=np.bool_)
        places = np.stack([x_m, y_m], axis=1)
        for number, (_, place, _, _) in enumerate(self.roads):
            if number != but:
                reach = place.kerb_m + beyond_m
                away, _ = self._trees[number].query(places, distance_upper_bound=reach)
                free &= np.isinf(away)
        return free


@dataclass(frozen=True, slots=True)
class _Put:
    along_m: float
    across_m: float
    turned_rad: float
    scale: tuple[float, float, float]
    sunk_m: float


class _Builder:
    """Notes what goes where along one road, and places all of it at once."""

    def __init__(
        self, network: Network, number: int, green: float, rng: np.random.Generator
    ) -> None:
        self.network, self.number, self.green, self.rng = network, number, green, rng
        self.road, self.place, _, _ = network.roads[number]
        self.whole: list[Mesh] = []
        self._put: dict[int, tuple[Mesh, list[_Put]]] = {}
        _, _, low, high = network.roads[number]
        self._free_at: dict[tuple[float, float], NDArray[np.bool_]] = {}
        self._steps = np.arange(low - 40.0, high + 40.0)

    def free(self, along_m: float, across_m: float, beyond_m: float = 0.5) -> bool:
        """Whether a place along this road lies on no other road; to the metre."""
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
        """Put a mesh beside the road, on the ground."""
        three = scale if isinstance(scale, tuple) else (scale, scale, scale)
        _, places = self._put.setdefault(id(mesh), (mesh, []))
        places.append(_Put(along_m, across_m, turned_rad, three, sunk_m))

    def block(
        self,
        size_m: tuple[float, float, float, float],
        what: StreetClass,
        material: Material,
        along_m: float,
        across_m: float,
    ) -> None:
        """Put a box of this length, width, low and high beside the road."""
        length, width, low, high = size_m
        scale = (length, width, high - low)
        self.put(_unit_box(what, material), along_m, across_m, scale=scale, sunk_m=-low)

    def meshes(self) -> list[Mesh]:
        """Place all that was put."""
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


def build_scenery(network: Network, *, green: float, rng: np.random.Generator) -> list[Mesh]:
    """Line all roads on both sides.

    Porches and pillars face along the road: without them odometry would slide on smooth fronts.

    Args:
        network: The roads.
        green: How much more than usual grows there; 1 is usual.
        rng: Of the street.
    """
    meshes: list[Mesh] = []
    for number, (_, place, from_m, to_m) in enumerate(network.roads):
        build = _Builder(network, number, green, rng)
        for side in (1, -1):
            if place.pavement_m > 0:
                _pavement(build, from_m, to_m, side)
            if place.facade_m > 0:
                _fronts(build, from_m, to_m, side)
            if place.gardens:
                _gardens(build, from_m, to_m, side)
            if place.barriers:
                _barriers(build, from_m, to_m, side)
            _furniture(build, from_m, to_m, side)
            _greenery(build, from_m, to_m, side)
        meshes += build.meshes()
    return meshes


def bump_meshes(terrain: Terrain) -> list[Mesh]:
    """Make the speed bumps that the terrain knows."""
    meshes = []
    along = np.linspace(-BUMP_HALF_M, BUMP_HALF_M, 9)
    for x, y, heading, half_width, high in terrain.bumps:
        across = np.linspace(-half_width, half_width, 9)
        a, b = np.meshgrid(along, across, indexing="ij")
        east = x + a * np.cos(heading) - b * np.sin(heading)
        north = y + a * np.sin(heading) + b * np.cos(heading)
        up = terrain.slope_m(east, north) + high * bump_profile(a) + 0.012
        corners = np.stack([east, north, up], axis=-1)
        meshes.append(grid(corners, StreetClass.ROAD, Material.STONE))
    return meshes


def _pavement(build: _Builder, from_m: float, to_m: float, side: int) -> None:
    """Lay kerb and pavement, interrupted where other roads come in."""
    place, step = build.place, 2.0
    along = np.arange(from_m, to_m, step)
    profile = np.array([(0.0, -0.05), (0.02, KERB_HIGH_M), (place.pavement_m, KERB_HIGH_M)])
    across = side * (place.kerb_m + profile[:, 0])
    x, y, _ = build.road.place(
        np.repeat(along[:, None], 3, axis=1), np.broadcast_to(across, (len(along), 3))
    )
    z = build.network.terrain.slope_m(x, y) + profile[:, 1]
    kept = build.network.free_of_roads(
        x[:, 0].copy(), y[:, 0].copy(), beyond_m=0.0, but=build.number
    )
    corners = np.stack([x, y, z], axis=-1)
    for run in np.split(np.arange(len(along)), np.flatnonzero(~kept)):
        stretch = run[kept[run]]
        if len(stretch) > 1:
            build.whole.append(grid(corners[stretch], StreetClass.SIDEWALK, Material.STONE))


def _fronts(build: _Builder, from_m: float, to_m: float, side: int) -> None:
    """Stand houses in a row, or apart where there are gardens."""
    place, rng, at = build.place, build.rng, from_m
    rural = place.name == "country"
    while at < to_m - 3.0:
        length, depth = float(rng.uniform(7.0, 18.0)), float(rng.uniform(8.0, 14.0))
        high = float(rng.uniform(4.0, 8.0) if place.gardens else rng.uniform(5.0, 18.0))
        back = float(rng.choice([0.0, 0.0, 0.6, 1.5, 3.0])) * (2.0 if place.gardens else 1.0)
        front = place.facade_m + back
        corners = [
            (at, front),
            (at + length, front),
            (at, front + depth),
            (at + length, front + depth),
        ]
        if all(build.free(a, side * b) for a, b in corners):
            middle = at + length / 2
            build.put(
                _house(length, depth, high, pointed=place.gardens),
                *(middle, side * (front + depth / 2)),
                sunk_m=1.5,
            )
            _relief(build, at, length, side * front, high)
        gap = rng.choice([0.0, 0.0, 3.0])
        if place.gardens:
            gap = rng.uniform(40.0, 120.0) if rural else rng.uniform(4.0, 14.0)
        at += length + float(gap)


def _house(length_m: float, depth_m: float, high_m: float, *, pointed: bool) -> Mesh:
    what, wall = StreetClass.BUILDING, Material.WALL
    body = box(length_m, depth_m, 0.0, high_m + 1.5, what=what, material=wall)
    if not pointed:
        return body
    half_l, half_d, eaves, ridge = length_m / 2, depth_m / 2 + 0.3, high_m + 1.5, high_m + 5.0
    roof = np.array(
        [
            *[(-half_l, -half_d, eaves), (half_l, -half_d, eaves), (half_l, half_d, eaves)],
            *[(-half_l, half_d, eaves), (-half_l, 0.0, ridge), (half_l, 0.0, ridge)],
        ]
    )
    faces = [(0, 1, 5), (0, 5, 4), (2, 3, 4), (2, 4, 5), (0, 4, 3), (1, 2, 5)]
    return Mesh.merged([body, Mesh.of(roof, faces, what, Material.STONE)])


def _relief(
    build: _Builder, start_m: float, length_m: float, front_m: float, high_m: float
) -> None:
    """Pillars, porches, balconies and window panes of one front."""
    rng, what = build.rng, StreetClass.BUILDING
    if rng.random() < 0.6:
        at = start_m + length_m * float(rng.uniform(0.2, 0.8))
        build.block((1.8, 1.0, 0.0, 3.2), what, Material.WALL, at, front_m)
    ends = np.arange(start_m + 0.3, start_m + length_m, float(rng.uniform(2.4, 4.2))).tolist()
    for at in ends:
        build.block((0.5, 0.7, 0.0, high_m - 0.4), what, Material.WALL, at, front_m)
    for floor_m in np.arange(0.0, high_m - 2.0, 3.1).tolist():
        for at in ends[:-1]:
            pane = (1.1, 0.06, floor_m + 1.0, floor_m + 2.3)
            outside = front_m - 0.02 * float(np.sign(front_m))
            build.block(pane, what, Material.GLASS, at + 1.3, outside)
        for at in ends[::2] if floor_m > 2.0 else []:
            if rng.random() < 0.5:
                slab = (1.8, 2.2, floor_m, floor_m + 1.0)
                build.block(slab, what, Material.WALL, at + 1.0, front_m)


def _gardens(build: _Builder, from_m: float, to_m: float, side: int) -> None:
    """Close gardens off by fences, walls or hedges."""
    place, rng = build.place, build.rng
    line = side * (place.kerb_m + max(place.pavement_m, 2.0) + 0.4)
    at = from_m
    while at < to_m - 4.0:
        length = float(rng.uniform(8.0, 24.0))
        sort = rng.random()
        for piece in np.arange(at + 1.0, min(at + length - 2.5, to_m), 2.0):
            if not build.free(float(piece), line, 1.0):
                continue
            if sort < 0.35:
                build.put(hedge(int(piece) % SORTS), float(piece), line)
            elif sort < 0.6:
                build.put(_fence(), float(piece), line, sunk_m=0.05)
            elif sort < 0.8:
                low_wall = (2.02, 0.25, -0.2, 1.2)
                build.block(low_wall, StreetClass.FENCE, Material.STONE, float(piece), line)
        at += length


@cache
def _fence() -> Mesh:
    """Two metres of pickets, seen through here and there."""
    what, wood = StreetClass.FENCE, Material.WOOD
    slats = [
        box(0.09, 0.03, 0.05, 1.15, what=what, material=wood, x_m=float(x))
        for x in np.arange(-0.95, 1.0, 0.19)
    ]
    bars = [box(2.0, 0.05, z, z + 0.08, what=what, material=wood, y_m=0.04) for z in (0.3, 0.9)]
    return Mesh.merged([*slats, *bars])


def _barriers(build: _Builder, from_m: float, to_m: float, side: int) -> None:
    """Concrete between the directions, rails and noise walls beside, gantries above."""
    rng, place = build.rng, build.place
    fence, metal = StreetClass.FENCE, Material.METAL
    noise_wall = rng.random() < 0.5
    rail_m, wall_m = side * (place.kerb_m + 0.6), side * (place.kerb_m + 5.0)
    for at in np.arange(from_m, to_m, 4.0):
        along = float(at) + 2.0
        if side > 0:
            build.block((4.05, 0.5, -0.1, 0.9), fence, Material.STONE, along, 0.0)
        build.block((4.05, 0.08, 0.45, 0.78), fence, metal, along, rail_m)
        build.block((0.12, 0.1, 0.0, 0.7), fence, metal, along, rail_m)
        if noise_wall:
            house = StreetClass.BUILDING
            build.block((3.9, 0.2, -0.4, 4.0), house, Material.WALL, along, wall_m)
            build.block((0.25, 0.35, -0.4, 4.2), house, metal, along + 2.0, wall_m)
    for at in np.arange(from_m + 60.0, to_m, 210.0) if side > 0 else []:
        half = place.kerb_m + 1.2
        pole = StreetClass.POLE
        beam = limb((0.0, -half, 6.4), (0.0, half, 6.4), 0.2, 0.2, what=pole, material=metal)
        legs = [
            limb((0.0, y, -0.3), (0.0, y, 6.5), 0.2, 0.2, what=pole, material=metal)
            for y in (-half, half)
        ]
        boards = [
            box(0.1, 4.0, 5.6, 7.6, what=StreetClass.SIGN, material=Material.MIRROR, y_m=y)
            for y in (-7.0, 7.0)
        ]
        build.put(Mesh.merged([beam, *legs, *boards]), float(at), 0.0)


def _furniture(build: _Builder, from_m: float, to_m: float, side: int) -> None:
    """Put poles, lamps, signs, lights, bollards, cabinets and bins beside the carriageway."""
    place, rng = build.place, build.rng
    kerb = side * (place.kerb_m + (0.6 if place.pavement_m else 1.4))
    at = from_m + float(rng.uniform(1.0, 6.0))
    thing = StreetClass.OBJECT
    while at < to_m - 2.0:
        draw = rng.random()
        if not build.free(at, kerb, 1.0):
            at += 2.0
            continue
        if draw < 0.3:
            build.put(_lamp(float(rng.uniform(5.0, 8.0))), at, kerb, turned_rad=np.pi / 2 * -side)
        elif draw < 0.5:
            build.put(_sign(rng), at, kerb, turned_rad=0.0 if side < 0 else np.pi)
        elif draw < 0.65 and place.pavement_m:
            for step in (0.0, 1.4, 2.8):
                if build.free(at + step, kerb, 1.0):
                    build.put(_unit_rod(), at + step, kerb, scale=(0.22, 0.22, 0.95))
        elif draw < 0.8 and place.pavement_m:
            long, high = float(rng.uniform(0.6, 1.6)), float(rng.uniform(0.9, 1.6))
            deep = side * (place.kerb_m + min(place.pavement_m, 3.6) - 0.7)
            build.block((long, 0.7, 0.0, high), thing, Material.METAL, at, deep)
        elif draw < 0.9:
            wide = 0.58 if place.pavement_m else 0.12  # a bin, or a post that marks the edge
            build.put(_unit_rod(), at, kerb, scale=(wide, wide, 1.0))
        at += float(rng.uniform(4.0, 12.0)) * (1.0 if place.pavement_m else 4.0)


@cache
def _unit_rod() -> Mesh:
    return limb(
        *((0, 0, 0), (0, 0, 1.0), 0.5, 0.5), what=StreetClass.OBJECT, material=Material.METAL
    )


def _lamp(high_m: float) -> Mesh:
    pole, metal = StreetClass.POLE, Material.METAL
    return Mesh.merged(
        [
            limb((0, 0, -0.2), (0, 0, high_m), 0.1, 0.06, what=pole, material=metal),
            limb((0, 0, high_m), (1.4, 0, high_m + 0.2), 0.05, 0.04, what=pole, material=metal),
            box(0.6, 0.25, high_m + 0.1, high_m + 0.25, what=pole, material=metal, x_m=1.5),
        ]
    )


def _sign(rng: np.random.Generator) -> Mesh:
    high, wide = float(rng.uniform(2.2, 3.0)), float(rng.uniform(0.5, 0.9))
    return Mesh.merged(
        [
            limb(
                (0, 0, -0.2),
                (0, 0, high),
                0.04,
                0.04,
                what=StreetClass.POLE,
                material=Material.METAL,
            ),
            box(
                *(0.03, wide, high - wide, high),
                what=StreetClass.SIGN,
                material=Material.MIRROR,
                x_m=-0.06,
            ),
        ]
    )


def _greenery(build: _Builder, from_m: float, to_m: float, side: int) -> None:
    """Plant trees along the kerb, and trees, bushes and grass beyond."""
    place, rng = build.place, build.rng
    length = to_m - from_m
    near = place.kerb_m + (1.2 if place.pavement_m else 3.0)
    for _ in range(round(length / 100.0 * place.trees_per_100_m * build.green)):
        along = float(rng.uniform(from_m, to_m))
        deep = 0.0 if rng.random() < 0.5 else float(rng.uniform(2.0, 22.0))
        if not place.gardens and not place.barriers:
            deep = 0.0
        if build.free(along, side * (near + deep), 1.0):
            size = float(rng.uniform(0.7, 1.5))
            build.put(
                tree(int(rng.integers(SORTS))),
                *(along, side * (near + deep)),
                turned_rad=float(rng.uniform(0.0, 6.3)),
                scale=size,
            )
    wild = (8.0 if place.gardens or place.barriers else 1.5) * build.green
    for _ in range(round(length / 100.0 * wild)):
        along = float(rng.uniform(from_m, to_m))
        across = side * (near + 0.6 + float(rng.uniform(0.0, 14.0 if place.gardens else 6.0)))
        if build.free(along, across, 1.0):
            size = float(rng.uniform(0.6, 1.5))
            build.put(
                bush(int(rng.integers(SORTS))),
                *(along, across),
                turned_rad=float(rng.uniform(0.0, 6.3)),
                scale=size,
            )
            if place.pavement_m < 5.0:
                build.put(grass(int(rng.integers(SORTS))), along + 3.0, across)


def junction_furniture(
    network: Network, main: int, junctions_m: Sequence[float], rng: np.random.Generator
) -> list[Mesh]:
    """Stand traffic lights at the corners of junctions."""
    build = _Builder(network, main, 1.0, rng)
    pole = StreetClass.POLE
    light = Mesh.merged(
        [
            limb((0, 0, -0.2), (0, 0, 3.4), 0.08, 0.07, what=pole, material=Material.METAL),
            box(0.3, 0.35, 2.4, 3.4, what=StreetClass.SIGN, material=Material.METAL),
        ]
    )
    place = build.place
    for at in junctions_m:
        for ahead in (1, -1):
            for side in (1, -1):
                build.put(light, at + ahead * (place.kerb_m + 1.0), side * (place.kerb_m + 0.8))
    return build.meshes()
