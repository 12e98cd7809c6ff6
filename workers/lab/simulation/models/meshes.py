"""Triangle meshes, and the solids from which streets are built."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workers.lab.simulation.models.kinds import Material, StreetClass

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles with class and material.

    Attributes:
        corners_m: (V, 3) vertices, in the space of the object.
        triangles: (T, 3) indices into `corners_m`.
        class_id: (T,) `StreetClass`.
        material: (T,) `Material`.
    """

    corners_m: Floats
    triangles: NDArray[np.int32]
    class_id: NDArray[np.uint8]
    material: NDArray[np.uint8]

    @classmethod
    def of(
        cls, corners_m: ArrayLike, triangles: ArrayLike, what: StreetClass, material: Material
    ) -> Self:
        """Build a mesh of one class and one material."""
        corners = np.asarray(corners_m, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(triangles, dtype=np.int32).reshape(-1, 3)
        return cls(
            corners,
            faces,
            np.full(len(faces), what, dtype=np.uint8),
            np.full(len(faces), material, dtype=np.uint8),
        )

    @classmethod
    def merged(cls, meshes: Sequence["Mesh"]) -> Self:
        """Concatenate meshes of one space."""
        if not meshes:
            return cls(
                np.zeros((0, 3)),
                np.zeros((0, 3), np.int32),
                np.zeros(0, np.uint8),
                np.zeros(0, np.uint8),
            )
        first = np.cumsum([0, *(len(m.corners_m) for m in meshes[:-1])])
        return cls(
            np.concatenate([m.corners_m for m in meshes]),
            np.concatenate([m.triangles + at for m, at in zip(meshes, first, strict=True)]).astype(
                np.int32
            ),
            np.concatenate([m.class_id for m in meshes]),
            np.concatenate([m.material for m in meshes]),
        )

    def __len__(self) -> int:
        """Count the triangles."""
        return len(self.triangles)

    def placed(
        self,
        x_m: float,
        y_m: float,
        z_m: float = 0.0,
        *,
        yaw_rad: float = 0.0,
        scale: ArrayLike = 1.0,
    ) -> "Mesh":
        """Scale (one factor, or three), rotate about z, and translate."""
        scaled = self.corners_m * np.asarray(scale)
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        corners = np.stack(
            [
                cos * scaled[:, 0] - sin * scaled[:, 1] + x_m,
                sin * scaled[:, 0] + cos * scaled[:, 1] + y_m,
                scaled[:, 2] + z_m,
            ],
            axis=1,
        )
        return Mesh(corners, self.triangles, self.class_id, self.material)


_LOFT_FACES = np.array([(0, 1, 5), (0, 5, 4), (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6)])
_LOFT_UNDER = np.array([(3, 0, 4), (3, 4, 7)])
_CAP = np.array([(0, 1, 2), (0, 2, 3)])


def box(
    length_m: float,
    width_m: float,
    low_m: float,
    high_m: float,
    *,
    what: StreetClass,
    material: Material,
    x_m: float = 0.0,
    y_m: float = 0.0,
    yaw_rad: float = 0.0,
) -> Mesh:
    """Build an upright box."""
    half_l, half_w = length_m / 2, width_m / 2
    made = loft(
        [(-half_l, half_w, half_w, low_m, high_m), (half_l, half_w, half_w, low_m, high_m)],
        what=what,
        sides=material,
        top=material,
    )
    return made.placed(x_m, y_m, yaw_rad=yaw_rad)


def loft(
    sections: Sequence[tuple[float, float, float, float, float]],
    *,
    what: StreetClass,
    sides: Material,
    top: Material,
    ends: Material | None = None,
) -> Mesh:
    """Build a closed tube along x through upright trapezia, such as the body of a vehicle.

    Args:
        sections: x, half width below, half width above, low and high of each, in metres, x rising.
        what: Class of all of it.
        sides: Material of both flanks.
        top: Material of the upper side (sloping parts included) and of the underside.
        ends: Material of the first and the last section; the material of the sides when None.
    """
    corners = np.array(
        [
            corner
            for x, below, above, low, high in sections
            for corner in ((x, -below, low), (x, -above, high), (x, above, high), (x, below, low))
        ]
    )
    faces, material = [], []
    for k in range(len(sections) - 1):
        faces += [_LOFT_FACES + 4 * k, _LOFT_UNDER + 4 * k]
        material += [sides, sides, top, top, sides, sides, top, top]
    faces += [_CAP, _CAP + 4 * (len(sections) - 1)]
    material += [sides if ends is None else ends] * 4
    triangles = np.concatenate(faces)
    return Mesh(
        corners,
        triangles.astype(np.int32),
        np.full(len(triangles), what, dtype=np.uint8),
        np.array(material, dtype=np.uint8),
    )


def limb(
    start_m: ArrayLike,
    end_m: ArrayLike,
    start_radius_m: float,
    end_radius_m: float,
    *,
    what: StreetClass,
    material: Material,
    sides: int = 8,
) -> Mesh:
    """Build a round rod between two places: poles, trunks, legs, wheels."""
    start, end = np.asarray(start_m, dtype=np.float64), np.asarray(end_m, dtype=np.float64)
    axis = (end - start) / np.linalg.norm(end - start)
    aside = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.9 else (1.0, 0.0, 0.0))
    aside /= np.linalg.norm(aside)
    other = np.cross(axis, aside)
    turn = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    ring = np.cos(turn)[:, None] * aside + np.sin(turn)[:, None] * other
    corners = np.concatenate(
        [start + start_radius_m * ring, end + end_radius_m * ring, [start, end]]
    )
    here = np.arange(sides)
    then = (here + 1) % sides
    low, high = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = np.concatenate(
        [
            np.stack([here, then, then + sides], axis=1),
            np.stack([here, then + sides, here + sides], axis=1),
            np.stack([low, then, here], axis=1),
            np.stack([high, here + sides, then + sides], axis=1),
        ]
    )
    return Mesh.of(corners, faces, what, material)


def ball(
    centre_m: ArrayLike,
    radii_m: ArrayLike,
    *,
    what: StreetClass,
    material: Material,
    sides: int = 8,
    rings: int = 5,
) -> Mesh:
    """Build an ellipsoid: heads, bodies of animals, boulders."""
    turn = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    lift = np.linspace(-np.pi / 2, np.pi / 2, rings + 2)
    unit = np.stack(
        [
            np.cos(lift)[:, None] * np.cos(turn),
            np.cos(lift)[:, None] * np.sin(turn),
            np.repeat(np.sin(lift)[:, None], sides, axis=1),
        ],
        axis=-1,
    )
    return grid(unit * np.asarray(radii_m) + np.asarray(centre_m), what, material, closed=True)


def grid(corners_m: Floats, what: StreetClass, material: Material, *, closed: bool = False) -> Mesh:
    """Build a mesh over (N, M, 3) vertices; `closed` joins the last of each row to its first."""
    n, m = corners_m.shape[:2]
    index = np.arange(n * m).reshape(n, m)
    if closed:
        index = np.concatenate([index, index[:, :1]], axis=1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate(
        [np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)]
    )
    return Mesh.of(corners_m.reshape(-1, 3), faces, what, material)


def leaves(
    centres_m: Floats, size_m: float, rng: np.random.Generator, *, what: StreetClass
) -> Mesh:
    """Scatter small triangles about places: foliage through which some beams pass."""
    corners = centres_m[:, None, :] + rng.normal(0.0, size_m / 2, (len(centres_m), 3, 3))
    return Mesh.of(
        corners.reshape(-1, 3),
        np.arange(3 * len(centres_m)).reshape(-1, 3),
        what,
        Material.LEAF,
    )
