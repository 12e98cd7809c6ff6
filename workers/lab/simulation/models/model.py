"""The shape of an actor, put together of meshes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, limb

PHASES: Final = 8
"""Poses of one stride of whoever walks or pedals."""

Section = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The shape of an actor in its own space: x ahead, z up, the origin on the ground below it.

    Attributes:
        name: Unique.
        street_class: What it is.
        size_m: Length, width, height of the box around it, centred on the origin.
        phases: Its shape through one stride; a single one where nothing swings.
        stride_m: Way of one stride.
    """

    name: str
    street_class: StreetClass
    size_m: tuple[float, float, float]
    phases: tuple[Mesh, ...]
    stride_m: float = 1.0


def make_model(
    name: str,
    what: StreetClass,
    phases: list[list[Mesh]],
    stride_m: float = 1.0,
    *,
    beyond_size: Sequence[Mesh] = (),
) -> Model:
    """Put a model together; what is `beyond_size` sticks out of its box."""
    meshes = tuple(Mesh.merged(parts) for parts in phases)
    corners = np.concatenate([mesh.corners_m for mesh in meshes])
    half = np.abs(corners[:, :2]).max(axis=0)
    size = (2 * float(half[0]), 2 * float(half[1]), float(corners[:, 2].max()))
    whole = tuple(Mesh.merged([mesh, *beyond_size]) for mesh in meshes)
    return Model(name, what, size, whole, stride_m)


def wheels_at(
    what: StreetClass, places: list[tuple[float, float]], radius_m: float, width_m: float
) -> list[Mesh]:
    """Wheels at these places beside the body."""
    return [
        limb(
            (x, y - width_m / 2, radius_m),
            (x, y + width_m / 2, radius_m),
            radius_m,
            radius_m,
            what=what,
            material=Material.RUBBER,
            sides=12,
        )
        for x, y in places
    ]
