"""Terrain height: slopes, small unevenness, and speed bumps."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Places = Floats | float

ROAD_WAVES: Final = np.array(
    [
        (0.006, 2.4, 0.7, 0.3),
        (0.012, 0.5, 1.1, 1.9),
        (0.015, -0.45, 0.31, 4.0),
        (0.03, 0.17, -0.09, 5.1),
    ]
)
"""Waves of any ground: height in metres, radians per metre along x and y, and phase.

On a perfect plane, the rings on the road are constant in sensor space, and odometry estimates no
motion.
"""

BUMP_HALF_M: Final = 1.2
_GRAZING: Final = 0.3
"""Largest displacement of a hit by unevenness, as a share of its range."""


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """Ground height as a function of place.

    Attributes:
        slopes: (W, 4) as `ROAD_WAVES`, long enough for a coarse triangle mesh.
        waves: (W, 4) `ROAD_WAVES`, too short for the mesh; hits are displaced instead.
        bumps: (B, 5) x, y, heading, half width across and height of each speed bump.
    """

    slopes: Floats
    waves: Floats
    bumps: Floats

    @classmethod
    def even(cls) -> "Terrain":
        """Return a plane at height 0."""
        return cls(np.zeros((0, 4)), np.zeros((0, 4)), np.zeros((0, 5)))

    def slope_m(self, x_m: Places, y_m: Places) -> Floats:
        """Return the height of the triangle mesh, without unevenness and bumps."""
        return _waves(self.slopes, x_m, y_m)

    def height_m(self, x_m: Places, y_m: Places, *, felt: float = 1.0) -> Floats:
        """Return the height of the ground, with the share `felt` of its unevenness."""
        height = self.slope_m(x_m, y_m) + felt * _waves(self.waves, x_m, y_m)
        for x, y, heading, half_width, high in self.bumps:
            dx, dy = np.asarray(x_m) - x, np.asarray(y_m) - y
            along = dx * np.cos(heading) + dy * np.sin(heading)
            across = -dx * np.sin(heading) + dy * np.cos(heading)
            on = (np.abs(along) < BUMP_HALF_M) & (np.abs(across) < half_width)
            height = height + np.where(on, high * bump_profile(along), 0.0)
        return height

    def shift_m(self, x_m: Floats, y_m: Floats, sine: Floats, range_m: Floats) -> Floats:
        """Return the range by which a beam ends nearer, since the ground rises above the mesh.

        Args:
            x_m: (N,) hit of the beam on the mesh, world x.
            y_m: (N,) the same, world y.
            sine: (N,) sine of the elevation of the beam, negative.
            range_m: (N,) length of the beam.
        """
        rise = _waves(self.waves, x_m, y_m)
        most = _GRAZING * range_m
        return np.clip(rise / np.minimum(sine, -1e-3), -most, most)


def bump_profile(along_m: Floats) -> Floats:
    """Return the height of a bump at a distance from its middle, as a share of its peak."""
    return 0.5 + 0.5 * np.cos(np.pi * np.clip(along_m / BUMP_HALF_M, -1.0, 1.0))


def hills(rng: np.random.Generator, *, steep: float) -> Floats:
    """Draw slopes whose steepest grade is about `steep`: waves of 60 to 260 m."""
    length = rng.uniform(60.0, 260.0, 4)
    turn = rng.uniform(0.0, 2 * np.pi, 4)
    rate = 2 * np.pi / length
    share = rng.dirichlet(np.full(4, 2.0))
    return np.stack(
        [
            steep * share / rate,
            rate * np.cos(turn),
            rate * np.sin(turn),
            rng.uniform(0.0, 2 * np.pi, 4),
        ],
        axis=1,
    )


def _waves(waves: Floats, x_m: Places, y_m: Places) -> Floats:
    height = np.zeros(np.broadcast_shapes(np.shape(x_m), np.shape(y_m)))
    for high, along_x, along_y, phase in waves:
        height += high * np.sin(along_x * np.asarray(x_m) + along_y * np.asarray(y_m) + phase)
    return height
