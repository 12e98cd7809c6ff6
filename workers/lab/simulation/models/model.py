"""Model of an actor, assembled from meshes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, limb

PHASES: Final = 8
"""Number of phases of one stride or pedal turn."""

Section = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The shape of an actor in its own space: x ahead, z up, the origin on the ground below it.

    Attributes:
        name: Unique name.
        street_class: Its class.
        size_m: Length, width, height of the box around it, centred on the origin.
        phases: Its shape through one stride; a single one for a rigid actor.
        stride_m: Path length of one stride.
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
    """Assemble a model; the meshes of `beyond_size` extend beyond its box."""
    meshes = tuple(Mesh.merged(parts) for parts in phases)
    corners = np.concatenate([mesh.corners_m for mesh in meshes])
    half = np.abs(corners[:, :2]).max(axis=0)
    size = (2 * float(half[0]), 2 * float(half[1]), float(corners[:, 2].max()))
    whole = tuple(Mesh.merged([mesh, *beyond_size]) for mesh in meshes)
    return Model(name, what, size, whole, stride_m)


def wheels_at(
    what: StreetClass, places: list[tuple[float, float]], radius_m: float, width_m: float
) -> list[Mesh]:
    """Build wheels at these places of a body."""
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
