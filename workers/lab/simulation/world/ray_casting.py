"""Ray casting for a spinning lidar: one Embree scene of all static geometry, one per mover model.

A spinning sensor sees each mover at a different instant. Instead of moving triangles, each beam is
transformed into the space of the mover at the time of firing. There it is cast against a scene that
was built once for all movers of that model. The rolling shutter is exact, and no acceleration
structure is ever rebuilt.
"""

from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final, Self

import numba
import numpy as np
from numpy.typing import NDArray

from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.models.meshes import Mesh
from workers.lab.simulation.models.model import Model
from workers.lab.simulation.models.models import models_of

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

NO_OWNER: Final = -1
GROUND_OWNER: Final = -2


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """First hit of each beam, in the order of the beams.

    Attributes:
        range_m: (N,) range; infinite where nothing is hit.
        class_id: (N,) `StreetClass`, 0 nothing.
        material: (N,) `Material`.
        owner: (N,) actor of the hit, -1 the street or nothing, -2 the bare ground.
        facing: (N,) cosine between the beam and the surface's normal, 0 to 1.
    """

    range_m: Floats32
    class_id: NDArray[np.uint8]
    material: NDArray[np.uint8]
    owner: NDArray[np.int32]
    facing: Floats32


class MeshScene:
    """A mesh to cast beams at."""

    def __init__(self, mesh: Mesh, owner: NDArray[np.int32] | None = None) -> None:
        """Store a mesh; its Embree scene is built when the first beam is cast.

        Args:
            mesh: Triangles, in the space of the beams.
            owner: (T,) actor of each triangle; None where all belong to the caller's mover.
        """
        self.class_id = np.append(mesh.class_id, np.uint8(0))
        self.material = np.append(mesh.material, np.uint8(0))
        self.owner = None if owner is None else np.append(owner, np.int32(NO_OWNER))
        self.low_m = mesh.corners_m.min(axis=0) if len(mesh) else np.zeros(3)
        self.high_m = mesh.corners_m.max(axis=0) if len(mesh) else np.zeros(3)
        self._mesh: Mesh | None = mesh
        self._scene: Any = None

    def cast(
        self, origins_m: Floats32, directions: Floats32, limit_m: Floats32
    ) -> tuple[Floats32, NDArray[np.int32], Floats32]:
        """Find the nearest triangle on each beam.

        Returns:
            (N,) range, infinite where nothing is hit within the limit; (N,) triangle, -1 none; and
            (N,) cosine of incidence.
        """
        if self._mesh is not None:
            self._build(self._mesh)
        if self._scene is None or not len(origins_m):
            n = len(origins_m)
            return np.full(n, np.inf, np.float32), np.full(n, -1, np.int32), np.zeros(n, np.float32)
        found = self._scene.run(origins_m, directions, dists=limit_m, output=True)
        triangle, normal = found["primID"], found["Ng"]
        facing = np.abs(np.einsum("ij,ij->i", normal, directions))
        facing /= np.maximum(np.sqrt(np.einsum("ij,ij->i", normal, normal)), 1e-9)
        range_m = np.where(triangle >= 0, found["tfar"], np.float32(np.inf))
        return range_m, triangle, facing

    def _build(self, mesh: Mesh) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._mesh = None
        if not len(mesh):
            return
        self._scene = EmbreeScene()
        corners = np.ascontiguousarray(mesh.corners_m, dtype=np.float32)
        TriangleMesh(self._scene, corners, np.ascontiguousarray(mesh.triangles, dtype=np.int32))


@cache
def phase_scenes(street_class: StreetClass, model: int) -> tuple[MeshScene, ...]:
    """Return the scenes of a model, one for each phase of its stride."""
    return tuple(MeshScene(mesh) for mesh in models_of(street_class)[model].phases)


@dataclass(frozen=True, slots=True, eq=False)
class Movers:
    """Moving actors during one revolution of the lidar.

    Attributes:
        owner: (M,) index among the actors.
        scenes: Scene of each mover.
        start: (M, 6) world x, y, z, yaw, pitch, roll when the revolution begins.
        end: (M, 6) the same when it ends; motion is linear between.
    """

    owner: NDArray[np.int32]
    scenes: tuple[MeshScene, ...] = field(default=())
    start: Floats = field(default_factory=lambda: np.zeros((0, 6)))
    end: Floats = field(default_factory=lambda: np.zeros((0, 6)))

    @classmethod
    def none(cls) -> Self:
        """Return an empty set of movers."""
        return cls(np.zeros(0, np.int32))


def cast(
    standing: MeshScene,
    movers: Movers,
    origins_m: Floats,
    directions: Floats,
    fraction: Floats,
    *,
    max_range_m: float,
) -> Hits:
    """Find the first hit of every beam of a revolution.

    Args:
        standing: All static geometry, in the world.
        movers: All movers.
        origins_m: (C, 3) world position of the sensor as each column fires.
        directions: (C, R, 3) world directions, unit.
        fraction: (C,) time of each firing within the revolution, 0 to 1.
        max_range_m: Largest range of a hit.
    """
    columns, rows = directions.shape[:2]
    base = origins_m[0]
    beams = np.ascontiguousarray(directions.reshape(-1, 3), dtype=np.float32)
    starts = np.repeat(origins_m, rows, axis=0).astype(np.float32)
    limit = np.full(columns * rows, max_range_m, dtype=np.float32)
    range_m, triangle, facing = standing.cast(starts, beams, limit)
    class_id, material = standing.class_id[triangle], standing.material[triangle]
    owner = (
        np.full(len(range_m), NO_OWNER, dtype=np.int32)
        if standing.owner is None
        else standing.owner[triangle]
    )
    hits = Hits(range_m, class_id, material, owner, facing)
    if len(movers.scenes):
        _cast_at_movers(hits, movers, origins_m - base, base, directions, fraction)
    return hits


def _cast_at_movers(
    hits: Hits,
    movers: Movers,
    origins_m: Floats,
    base_m: Floats,
    directions: Floats,
    fraction: Floats,
) -> None:
    start, end = movers.start.copy(), movers.end.copy()
    start[:, :3] -= base_m
    end[:, :3] -= base_m
    low = np.stack([scene.low_m for scene in movers.scenes]) - 0.02
    high = np.stack([scene.high_m for scene in movers.scenes]) + 0.02
    first = np.zeros(len(start) + 1, dtype=np.int64)
    room = 2 * len(hits.range_m)
    while True:
        local_origins = np.empty((room, 3), np.float32)
        local_directions = np.empty((room, 3), np.float32)
        beam = np.empty(room, np.int64)
        _into_movers(
            start, end, low, high, origins_m, directions, fraction, hits.range_m, first,
            local_origins, local_directions, beam,
        )  # fmt: skip
        if first[-1] <= room:
            break
        room = int(first[-1])
    for m in range(len(start)):
        mine = slice(int(first[m]), int(first[m + 1]))
        if mine.start == mine.stop:
            continue
        scene, beams = movers.scenes[m], beam[mine]
        limit = hits.range_m[beams]
        limit[~np.isfinite(limit)] = 1e4
        range_m, triangle, facing = scene.cast(local_origins[mine], local_directions[mine], limit)
        met = triangle >= 0
        hits.range_m[beams[met]] = range_m[met]
        hits.class_id[beams[met]] = scene.class_id[triangle[met]]
        hits.material[beams[met]] = scene.material[triangle[met]]
        hits.owner[beams[met]] = movers.owner[m]
        hits.facing[beams[met]] = facing[met]


@numba.njit(cache=True)
def _into_movers(
    start: Floats,
    end: Floats,
    low: Floats,
    high: Floats,
    origins_m: Floats,
    directions: Floats,
    fraction: Floats,
    range_m: Floats32,
    first: NDArray[np.int64],
    local_origins: Floats32,
    local_directions: Floats32,
    beam: NDArray[np.int64],
) -> None:
    """Transform the beams that hit a mover's box into its space, as far as there is room.

    `first`, (M + 1,), receives the index of the first beam of each mover, and their number.
    """
    at, room = 0, len(beam)
    columns, rows = directions.shape[0], directions.shape[1]
    rotation = np.empty((3, 3))
    o, d = np.empty(3), np.empty(3)
    for m in range(len(start)):
        first[m] = at
        radius = 0.0
        for k in range(3):
            radius += max(abs(low[m, k]), abs(high[m, k])) ** 2
        radius = np.sqrt(radius)
        for c in range(columns):
            f = fraction[c]
            x = start[m, 0] + f * (end[m, 0] - start[m, 0]) - origins_m[c, 0]
            y = start[m, 1] + f * (end[m, 1] - start[m, 1]) - origins_m[c, 1]
            z = start[m, 2] + f * (end[m, 2] - start[m, 2]) - origins_m[c, 2]
            ux, uy = directions[c, rows // 2, 0], directions[c, rows // 2, 1]
            length = np.hypot(ux, uy)
            ux, uy = ux / length, uy / length
            far = np.hypot(x, y)
            if abs(x * uy - y * ux) > radius + 0.15 * far or x * ux + y * uy < -radius:
                continue
            yaw = start[m, 3] + f * (end[m, 3] - start[m, 3])
            pitch = start[m, 4] + f * (end[m, 4] - start[m, 4])
            roll = start[m, 5] + f * (end[m, 5] - start[m, 5])
            cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
            cr, sr = np.cos(roll), np.sin(roll)
            rotation[0] = (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr)
            rotation[1] = (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr)
            rotation[2] = (-sp, cp * sr, cp * cr)
            for k in range(3):
                o[k] = -(rotation[0, k] * x + rotation[1, k] * y + rotation[2, k] * z)
            for r in range(rows):
                bx, by, bz = directions[c, r, 0], directions[c, r, 1], directions[c, r, 2]
                along = x * bx + y * by + z * bz
                if along < -radius or x * x + y * y + z * z - along * along > radius * radius:
                    continue
                enter, leave = 0.0, float(range_m[c * rows + r])
                for k in range(3):
                    d[k] = rotation[0, k] * bx + rotation[1, k] * by + rotation[2, k] * bz
                    if abs(d[k]) < 1e-12:
                        if o[k] < low[m, k] or o[k] > high[m, k]:
                            leave = -1.0
                    else:
                        near, away = (low[m, k] - o[k]) / d[k], (high[m, k] - o[k]) / d[k]
                        enter = max(enter, min(near, away))
                        leave = min(leave, max(near, away))
                if enter > leave:
                    continue
                if at < room:
                    for k in range(3):
                        local_origins[at, k] = o[k]
                        local_directions[at, k] = d[k]
                    beam[at] = c * rows + r
                at += 1
    first[len(start)] = at


def model_of(street_class: StreetClass, model: int) -> Model:
    """Return one model of a class."""
    models = models_of(street_class)
    return models[model % len(models)]
