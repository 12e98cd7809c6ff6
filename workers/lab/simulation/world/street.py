"""Street at every instant of a log: static geometry, actors, and the ego vehicle."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, grid
from workers.lab.simulation.models.model import Model
from workers.lab.simulation.models.models import models_of
from workers.lab.simulation.world.attitude import place_on_terrain, ride, rotations
from workers.lab.simulation.world.motion_along_road import TIME_STEP_S, Drive, Floats
from workers.lab.simulation.world.ray_casting import (
    GROUND_OWNER,
    NO_OWNER,
    MeshScene,
    Movers,
    model_of,
    phase_scenes,
)
from workers.lab.simulation.world.road_map import RoadMap
from workers.lab.simulation.world.terrain import ROAD_WAVES, Terrain
from workers.lab.simulation.world.weather import Weather

_UPRIGHT: Final = (StreetClass.PEDESTRIAN, StreetClass.ANIMAL)
_PLANE_M: Final = 600.0
_NET_M: Final = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Actor:
    """A movable object, moving or parked.

    Attributes:
        street_class: Its class.
        drive: Its trajectory.
        parked: Never moves in this log.
        model: Index among the models of its class.
        reflectivity: Reflectivity of its paint or clothes.
    """

    street_class: StreetClass
    drive: Drive
    parked: bool = False
    model: int = 0
    reflectivity: float = 0.4

    @property
    def shape(self) -> Model:
        """Its model."""
        return model_of(self.street_class, self.model)

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width, height of the box around it."""
        return self.shape.size_m


@dataclass(frozen=True, slots=True, eq=False)
class Street:
    """A whole street with its traffic.

    Attributes:
        seed: Seed of everything random in it, the sensor's noise included.
        seconds: Duration of its log.
        ego: The drive of the car that carries the lidar.
        actors: Everything movable; the index is the track id.
        standing_scene: All static geometry: the ground, the street itself, parked vehicles.
        terrain: Height of the ground.
        road_map: Class and material of the ground; None where all of it is carriageway.
        weather: Dust and rain.
        standing: (A, 3) world x, y, yaw of every actor as the log begins.
        moving_index: (M,) the actors that are not parked.
        moving: (K, M, 3) their poses, every `TIME_STEP_S`.
        travelled_m: (K, M) path length of each.
        ego_ride: (K, 6) x, y, z, yaw, pitch, roll of the ego's body, every `TIME_STEP_S`.
        place: Name of its kind.
        hard: Hardships of the street, if any.
    """

    seed: int
    seconds: float
    ego: Drive
    actors: tuple[Actor, ...]
    standing_scene: MeshScene = field(repr=False)
    terrain: Terrain = field(repr=False)
    road_map: RoadMap | None = field(repr=False)
    weather: Weather
    standing: Floats = field(repr=False)
    moving_index: NDArray[np.int64] = field(repr=False)
    moving: Floats = field(repr=False)
    travelled_m: Floats = field(repr=False)
    ego_ride: Floats = field(repr=False)
    place: str = ""
    hard: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        *,
        seed: int,
        seconds: float,
        ego: Drive,
        actors: Sequence[Actor],
        fixed: Sequence[Mesh],
        even: bool = False,
        terrain: Terrain | None = None,
        road_map: RoadMap | None = None,
        weather: Weather | None = None,
        place: str = "",
        hard: tuple[str, ...] = (),
    ) -> Self:
        """Assemble a street from static geometry and actors.

        Args:
            seed: Seed of all that is random in it.
            seconds: Duration of its log.
            ego: Drive of the car that carries the lidar.
            actors: Everything movable.
            fixed: Meshes of the street itself, in the world.
            even: Whether the ground is a plane where no terrain is given.
            terrain: The ground; only its small unevenness when None.
            road_map: Class and material of the ground.
            weather: Dust and rain; none when None.
            place: Name of its kind.
            hard: Hardships of the street.
        """
        if terrain is None:
            flat = Terrain.even()
            terrain = flat if even else Terrain(flat.slopes, ROAD_WAVES, flat.bumps)
        time = np.arange(0.0, seconds + 1.0, TIME_STEP_S)
        moving = [i for i, actor in enumerate(actors) if not actor.parked]
        poses = [actors[i].drive.pose(time) for i in moving]
        stacked = np.stack(poses, axis=1) if poses else np.zeros((len(time), 0, 3))
        steps = np.hypot(*np.diff(stacked[:, :, :2], axis=0).transpose(2, 0, 1))
        start = np.array([a.drive.pose(0.0) for a in actors]).reshape(-1, 3)
        return cls(
            seed=seed,
            seconds=seconds,
            ego=ego,
            actors=tuple(actors),
            standing_scene=_standing_scene(fixed, actors, start, terrain, ego),
            terrain=terrain,
            road_map=road_map,
            weather=weather or Weather(),
            standing=start,
            moving_index=np.array(moving, dtype=np.int64),
            moving=stacked,
            travelled_m=np.concatenate([np.zeros((1, len(moving))), np.cumsum(steps, axis=0)]),
            ego_ride=ride(ego, terrain, seconds=seconds),
            place=place,
            hard=hard,
        )

    def after(self, seconds: float) -> "Street":
        """Return the same street with a log that begins some seconds later, amid the traffic."""
        steps = round(seconds / TIME_STEP_S)
        later_s = steps * TIME_STEP_S
        return replace(
            self,
            seconds=round(self.seconds - seconds, 6),
            ego=self.ego.after(later_s),
            actors=tuple(replace(actor, drive=actor.drive.after(later_s)) for actor in self.actors),
            weather=self.weather.after(later_s),
            standing=self.actor_poses(later_s),
            moving=self.moving[steps:],
            travelled_m=self.travelled_m[steps:],
            ego_ride=self.ego_ride[steps:],
        )

    def actor_poses(self, time_s: float) -> Floats:
        """Return (A, 3) world x, y, yaw of every actor, constant outside the log."""
        before, share = self._step(time_s)
        poses = self.standing.copy()
        poses[self.moving_index] = (
            self.moving[before] * (1.0 - share) + self.moving[before + 1] * share
        )
        return poses

    def actor_bodies(self, time_s: float, of: NDArray[np.int64] | None = None) -> Floats:
        """Return (A, 6) world x, y, ground below, yaw, pitch, roll of actors, of all when None."""
        index = np.arange(len(self.actors)) if of is None else of
        poses = self.actor_poses(time_s)[index]
        tilts = np.array([self.actors[i].street_class not in _UPRIGHT for i in index], np.bool_)
        return place_on_terrain(poses, self.terrain, tilts=tilts)

    def actor_velocities(self, time_s: float) -> Floats:
        """Return (A, 2) world velocity of every actor, the mean over a tenth of a second."""
        early = max(time_s - 0.05, 0.0)
        late = early + 0.1
        return (self.actor_poses(late) - self.actor_poses(early))[:, :2] / 0.1

    def ego_bodies(self, time_s: Floats) -> Floats:
        """Return (T, 6) x, y, z, yaw, pitch and roll of the ego's body at these times."""
        at = np.arange(len(self.ego_ride)) * TIME_STEP_S
        return np.stack([np.interp(time_s, at, column) for column in self.ego_ride.T], axis=-1)

    def movers_during(self, start_s: float, end_s: float, *, within_m: float) -> Movers:
        """Return the unparked actors near the ego, for ray casting."""
        here = self.ego.pose(start_s)[:2]
        before, _ = self._step((start_s + end_s) / 2)
        places = self.moving[before, :, :2]
        near = np.flatnonzero(np.hypot(*(places - here).T) < within_m + 10.0)
        if not len(near):
            return Movers.none()
        owner = self.moving_index[near]
        scenes = []
        for actor_index, mover in zip(owner, near, strict=True):
            actor = self.actors[int(actor_index)]
            phases = phase_scenes(
                actor.street_class, actor.model % len(models_of(actor.street_class))
            )
            stride = self.travelled_m[before, mover] / actor.shape.stride_m
            scenes.append(phases[int(stride * len(phases)) % len(phases)])
        return Movers(
            owner.astype(np.int32),
            tuple(scenes),
            self.actor_bodies(start_s, owner),
            self.actor_bodies(end_s, owner),
        )

    def _step(self, time_s: float) -> tuple[int, float]:
        step = min(max(time_s / TIME_STEP_S, 0.0), len(self.moving) - 1.001)
        return int(step), step - int(step)


def _standing_scene(
    fixed: Sequence[Mesh], actors: Sequence[Actor], start: Floats, terrain: Terrain, ego: Drive
) -> MeshScene:
    meshes = [_ground(terrain, ego), *fixed]
    owners = [
        np.full(len(m), NO_OWNER if k else GROUND_OWNER, np.int32) for k, m in enumerate(meshes)
    ]
    parked = [i for i, actor in enumerate(actors) if actor.parked]
    if parked:
        tilts = np.array([actors[i].street_class not in _UPRIGHT for i in parked], np.bool_)
        bodies = place_on_terrain(start[parked], terrain, tilts=tilts)
        turns = rotations(bodies[:, 3], bodies[:, 4], bodies[:, 5])
        for i, body, turn in zip(parked, bodies, turns, strict=True):
            mesh = actors[i].shape.phases[0]
            corners = mesh.corners_m @ turn.T + body[:3]
            meshes.append(Mesh(corners, mesh.triangles, mesh.class_id, mesh.material))
            owners.append(np.full(len(mesh), i, np.int32))
    return MeshScene(Mesh.merged(meshes), np.concatenate(owners))


def _ground(terrain: Terrain, ego: Drive) -> Mesh:
    """Build the ground mesh around the whole drive."""
    beyond = _PLANE_M if not len(terrain.slopes) else 180.0
    low_x, high_x = float(ego.x_m.min()) - beyond, float(ego.x_m.max()) + beyond
    low_y, high_y = float(ego.y_m.min()) - beyond, float(ego.y_m.max()) + beyond
    step = (lambda low, high: 2) if not len(terrain.slopes) else _net_steps
    x = np.linspace(low_x, high_x, step(low_x, high_x))
    y = np.linspace(low_y, high_y, step(low_y, high_y))
    across, along = np.meshgrid(x, y, indexing="ij")
    corners = np.stack([across, along, terrain.slope_m(across, along)], axis=-1)
    return grid(corners, StreetClass.ROAD, Material.ASPHALT)


def _net_steps(low_m: float, high_m: float) -> int:
    return int((high_m - low_m) / _NET_M) + 2
