"""Weather returns: rain, dust and stray returns that end a beam in the air."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]

_DROPS_WITHIN_M: Final = 25.0


@dataclass(frozen=True, slots=True, eq=False)
class Weather:
    """Rain and dust.

    Attributes:
        rain_share: Share of beams returned by drops.
        puffs: (P, 6) x, y, z, radius in metres, first and last second of each cloud of dust.
        stray_share: Share of beams with a return at any range: sunlight, crosstalk.
    """

    rain_share: float = 0.0
    puffs: Floats = field(default_factory=lambda: np.zeros((0, 6)), repr=False)
    stray_share: float = 0.0

    def after(self, seconds: float) -> "Weather":
        """Return the same weather on a clock that begins some seconds later."""
        return replace(self, puffs=self.puffs - [0.0, 0.0, 0.0, 0.0, seconds, seconds])

    def answer(
        self,
        range_m: Floats32,
        origins_m: Floats,
        directions: Floats,
        *,
        time_s: float,
        max_range_m: float,
        rng: np.random.Generator,
    ) -> tuple[NDArray[np.bool_], Floats32]:
        """Find the beams that end in the air.

        Args:
            range_m: (C * R,) ranges without weather; infinite where nothing is hit.
            origins_m: (C, 3) world position of the sensor at each column.
            directions: (C, R, 3) unit, world.
            time_s: Seconds since the log began.
            max_range_m: Largest range of a return.
            rng: Random generator of this frame.

        Returns:
            (C * R,) beams that end in the air, and (C * R,) their ranges.
        """
        ends = np.zeros(len(range_m), dtype=np.bool_)
        nearer = range_m.copy()
        if self.rain_share > 0.0 or self.stray_share > 0.0:
            draw = rng.random(len(range_m), dtype=np.float32)
            drops = draw < self.rain_share
            strays = (draw >= self.rain_share) & (draw < self.rain_share + self.stray_share)
            far = 1.0 + _DROPS_WITHIN_M * rng.random(len(range_m), dtype=np.float32) ** 2
            far[strays] = max_range_m * rng.random(int(strays.sum()), dtype=np.float32)
            ends = (drops | strays) & (far < range_m)
            nearer[ends] = far[ends]
        for x, y, z, radius, first, last in self.puffs:
            if first <= time_s < last:
                self._dust_returns(
                    np.array([x, y, z]), radius * (0.5 + time_s - first), ends, nearer,
                    origins_m, directions, rng,
                )  # fmt: skip
        return ends, nearer

    @staticmethod
    def _dust_returns(
        centre_m: Floats,
        radius_m: float,
        ends: NDArray[np.bool_],
        nearer: Floats32,
        origins_m: Floats,
        directions: Floats,
        rng: np.random.Generator,
    ) -> None:
        """Let a dust cloud return some of the beams through it; it thins as it grows."""
        rows = directions.shape[1]
        to = centre_m - origins_m
        far = np.linalg.norm(to, axis=1)
        middle = directions[:, rows // 2]
        flat = np.hypot(middle[:, 0], middle[:, 1])
        ahead = (to[:, 0] * middle[:, 0] + to[:, 1] * middle[:, 1]) / flat
        aside = np.abs(to[:, 0] * middle[:, 1] - to[:, 1] * middle[:, 0]) / flat
        columns = np.flatnonzero((aside < radius_m) & (ahead > 0.0) & (far > radius_m))
        if not len(columns):
            return
        beams = directions[columns]
        along = np.einsum("crk,ck->cr", beams, to[columns])
        off = far[columns, None] ** 2 - along**2
        chord = np.sqrt(np.maximum(radius_m**2 - off, 0.0))
        at = along + chord * rng.uniform(-1.0, 1.0, along.shape)
        index = columns[:, None] * rows + np.arange(rows)
        share = 0.35 * chord / radius_m / (1.0 + radius_m)
        met = (rng.random(along.shape) < share) & (at < nearer[index]) & (at > 1.0)
        ends[index[met]] = True
        nearer[index[met]] = at[met]
