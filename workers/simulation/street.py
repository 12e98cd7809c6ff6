"""A street at every instant of a log: what stands, what moves, and the car that drives through."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from workers.simulation.cast import ROAD_WAVES
from workers.simulation.drive import TIME_STEP_S, Drive, Floats
from workers.simulation.kinds import SHAPES, SIZE_M, Shape, StreetClass


@dataclass(frozen=True, slots=True, eq=False)
class Actor:
    """A thing that could move, whether it does or is parked.

    Attributes:
        street_class: What it is.
        drive: Where it is at every time.
        parked: Never moves in this log.
    """

    street_class: StreetClass
    drive: Drive
    parked: bool = False

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width, height of the box around it."""
        return SIZE_M[self.street_class]


@dataclass(frozen=True, slots=True, eq=False)
class ShapeTable:
    """Many shapes as arrays, which is what the casting loop eats.

    Attributes:
        local: (S, 3) x, y, yaw in the space of the shape's owner; world for the street itself.
        form: (S, 5) half length, half width, low, high, is round (`cast.FORM_COLUMNS`).
        class_id: (S,) `StreetClass`.
        owner: (S,) index of the actor it belongs to, -1 the street.
    """

    local: Floats
    form: Floats
    class_id: NDArray[np.int64]
    owner: NDArray[np.int64]

    @classmethod
    def of(cls, shapes: Sequence[Shape], owners: Sequence[int]) -> Self:
        """Lay shapes out as arrays."""
        local = [(s.x_m, s.y_m, s.yaw_rad) for s in shapes]
        form = [
            (s.length_m / 2, s.width_m / 2, s.low_m, s.high_m, float(s.is_round)) for s in shapes
        ]
        return cls(
            np.array(local, dtype=np.float64).reshape(-1, 3),
            np.array(form, dtype=np.float64).reshape(-1, 5),
            np.array([s.street_class for s in shapes], dtype=np.int64),
            np.array(owners, dtype=np.int64),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Street:
    """A whole street with its traffic.

    Attributes:
        seed: Seed of everything random in it, the sensor's noise included.
        seconds: How long its log lasts.
        ego: The drive of the car that carries the lidar.
        actors: Everything movable; the index is the track id.
        fixed: Shapes of the street itself, world space.
        carried: Shapes of the actors, each in its actor's space.
        standing: (A, 3) world x, y, yaw of every actor as the log begins.
        moving_index: (M,) the actors that are not parked.
        moving: (K, M, 3) their poses, every `TIME_STEP_S`.
        road_waves: (W, 4) unevenness of the road (`cast.ROAD_WAVES`); none for a plane.
    """

    seed: int
    seconds: float
    ego: Drive
    actors: tuple[Actor, ...]
    fixed: ShapeTable
    carried: ShapeTable
    standing: Floats
    moving_index: NDArray[np.int64]
    moving: Floats
    road_waves: Floats

    @classmethod
    def of(
        cls,
        *,
        seed: int,
        seconds: float,
        ego: Drive,
        actors: Sequence[Actor],
        fixed: Sequence[Shape],
        even: bool = False,
    ) -> Self:
        """Put a street together from what stands and what moves; `even` makes the road a plane."""
        carried = [(s, i) for i, a in enumerate(actors) for s in SHAPES[a.street_class]]
        time = np.arange(0.0, seconds + 1.0, TIME_STEP_S)
        moving = [i for i, actor in enumerate(actors) if not actor.parked]
        poses = [actors[i].drive.pose(time) for i in moving]
        return cls(
            seed=seed,
            seconds=seconds,
            ego=ego,
            actors=tuple(actors),
            fixed=ShapeTable.of(fixed, [-1] * len(fixed)),
            carried=ShapeTable.of([s for s, _ in carried], [i for _, i in carried]),
            standing=np.array([a.drive.pose(0.0) for a in actors]).reshape(-1, 3),
            moving_index=np.array(moving, dtype=np.int64),
            moving=np.stack(poses, axis=1) if poses else np.zeros((len(time), 0, 3)),
            road_waves=ROAD_WAVES[:0] if even else ROAD_WAVES,
        )

    def actor_poses(self, time_s: float) -> Floats:
        """Give (A, 3) world x, y, yaw of every actor; outside the log its ends hold."""
        step = min(max(time_s / TIME_STEP_S, 0.0), len(self.moving) - 1.001)
        before = int(step)
        share = step - before
        poses = self.standing.copy()
        poses[self.moving_index] = (
            self.moving[before] * (1.0 - share) + self.moving[before + 1] * share
        )
        return poses

    def actor_velocities(self, time_s: float) -> Floats:
        """Give (A, 2) world velocity of every actor, the mean over a tenth of a second."""
        early = max(time_s - 0.05, 0.0)
        late = early + 0.1
        return (self.actor_poses(late) - self.actor_poses(early))[:, :2] / 0.1

    def shapes_during(
        self, start_s: float, end_s: float, *, within_m: float
    ) -> tuple[Floats, Floats, ShapeTable]:
        """Place every shape near the ego at two instants.

        Returns:
            (S, 3) world x, y, yaw at the first instant, the same at the second, and their table.
        """
        carried = self.carried
        start = _placed(self.actor_poses(start_s)[carried.owner], carried.local)
        end = _placed(self.actor_poses(end_s)[carried.owner], carried.local)
        start = np.concatenate([self.fixed.local, start])
        end = np.concatenate([self.fixed.local, end])
        form = np.concatenate([self.fixed.form, carried.form])
        class_id = np.concatenate([self.fixed.class_id, carried.class_id])
        owner = np.concatenate([self.fixed.owner, carried.owner])
        local = np.concatenate([self.fixed.local, carried.local])

        reach = np.hypot(form[:, 0], form[:, 1]) + within_m + 5.0
        near = np.hypot(*(start[:, :2] - self.ego.pose(start_s)[:2]).T) < reach
        table = ShapeTable(local[near], form[near], class_id[near], owner[near])
        return start[near], end[near], table


def _placed(pose: Floats, local: Floats) -> Floats:
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    return np.stack(
        [
            pose[:, 0] + cos * local[:, 0] - sin * local[:, 1],
            pose[:, 1] + sin * local[:, 0] + cos * local[:, 1],
            pose[:, 2] + local[:, 2],
        ],
        axis=1,
    )
