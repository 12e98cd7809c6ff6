"""Label noise of a model on the car: borders that bleed, blobs, flicker at range, late frames.

The noise depends on points, objects and labels alone, so simulated and real drives can have the
same. It is drawn by seed, and is temporally correlated as that of real models: an object's border
bleeds by a similar width in all frames, while blobs, flicker and late frames last a moment.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workers.lab.labels.blobs import Blobs
from workers.lab.labels.borders import BEHIND_RAD, INSIDE_M, REACH_M, Spread
from workers.lab.labels.noise_settings import (
    DYNAMIC,
    REAL,
    STATIC,
    ClassIds,
    MotionCodes,
    NoiseSettings,
    SeenFrame,
)


@dataclass(slots=True, eq=False)
class LabelNoise:
    """The noise of one drive; call it for every frame in the order of the drive.

    Attributes:
        seed: Seed of all that is drawn.
        blob_classes: Class ids that a blob may have.
        settings: Strength of each kind.
    """

    seed: int
    blob_classes: Sequence[int]
    settings: NoiseSettings = REAL
    _count: int = 0
    _before: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    _wrong_at: dict[int, int] = field(default_factory=dict)
    _blobs: Blobs = field(init=False)

    def __post_init__(self) -> None:
        """Begin without a blob."""
        self._blobs = Blobs(self.blob_classes, self.settings)

    def __call__(
        self, seen: SeenFrame, motion: MotionCodes, class_id: ClassIds
    ) -> tuple[MotionCodes, ClassIds]:
        """Return the labels with noise.

        Args:
            seen: The frame.
            motion: (N,) labels without noise: 0 unknown, 1 static, 2 dynamic.
            class_id: (N,) classes without noise.
        """
        rng = np.random.default_rng([self.seed, 0x2015E, self._count])
        motion, class_id = motion.copy(), class_id.copy()
        movers = _movers(seen.thing, motion)
        self._lag(seen, motion, movers, rng)
        self._flicker(seen, motion, movers, rng)
        self._bleed(seen, motion, class_id, rng)
        self._blobs.apply(seen, self._count, motion, class_id, rng)
        self._count += 1
        return motion, class_id

    def _lag(
        self,
        seen: SeenFrame,
        motion: MotionCodes,
        movers: dict[int, NDArray[np.int64]],
        rng: np.random.Generator,
    ) -> None:
        """Give some movers the label of the frame before: where they were is dynamic."""
        late = rng.random(len(movers)) < self.settings.late_share
        rotation, origin = seen.world_from_sensor[:3, :3], seen.world_from_sensor[:3, 3]
        around = seen.borders.around
        now = {}
        for (thing, mine), lags in zip(movers.items(), late.tolist(), strict=True):
            now[thing] = seen.points_m[mine] @ rotation.T + origin
            if not lags or self._rests(thing):
                continue
            self._wrong_at[thing] = self._count
            if thing not in self._before:
                motion[mine] = STATIC
                continue
            tree = cKDTree(self._before[thing])
            left = around.index[seen.thing[around.source] == thing]
            for rows, places_m, label in (
                (mine, now[thing], STATIC),
                (left, seen.points_m[left] @ rotation.T + origin, DYNAMIC),
            ):
                away_m, _ = tree.query(places_m, distance_upper_bound=_SAME_PLACE_M)
                there = np.isfinite(away_m)
                motion[rows[~there if label == STATIC else there]] = label
        self._before = now

    def _flicker(
        self,
        seen: SeenFrame,
        motion: MotionCodes,
        movers: dict[int, NDArray[np.int64]],
        rng: np.random.Generator,
    ) -> None:
        """Label some far movers static for a frame."""
        these = self.settings
        drawn = rng.random(len(movers))
        for (thing, mine), value in zip(movers.items(), drawn.tolist(), strict=True):
            range_m = float(np.hypot(*seen.points_m[mine, :2].mean(axis=0)))
            far = (range_m - these.flicker_from_m) / (these.flicker_full_m - these.flicker_from_m)
            if value < these.flicker_share * min(max(far, 0.0), 1.0) and not self._rests(thing):
                motion[mine] = STATIC
                self._wrong_at[thing] = self._count

    def _rests(self, thing: int) -> bool:
        wrong_at = self._wrong_at.get(thing)
        return wrong_at is not None and self._count - wrong_at <= self.settings.rest_frames

    def _bleed(
        self, seen: SeenFrame, motion: MotionCodes, class_id: ClassIds, rng: np.random.Generator
    ) -> None:
        """Spread labels over borders: outwards, onto what is behind, and inwards."""
        these = self.settings
        things = int(seen.thing.max(initial=-1)) + 1
        lasting = np.random.default_rng([self.seed, 0xB1EED]).standard_normal((_MOST_THINGS, 3))
        lasting = lasting[np.arange(things) % _MOST_THINGS]
        width = np.exp(these.bleed_spread * lasting + 0.25 * rng.standard_normal((things, 3)))
        right_motion, right_class = motion.copy(), class_id.copy()

        def spread(
            over: Spread, widths: NDArray[np.float64], objects: NDArray[np.int64], most: float
        ) -> None:
            ragged = rng.uniform(0.4, 1.3, len(over.index))
            taken = over.away < np.minimum(widths[objects] * ragged, most)
            motion[over.index[taken]] = right_motion[over.source[taken]]
            class_id[over.index[taken]] = right_class[over.source[taken]]

        around, behind, inside = seen.borders.around, seen.borders.behind, seen.borders.inside
        spread(inside, these.inside_m * width[:, 2], seen.thing[inside.index], INSIDE_M)
        range_m = np.hypot(seen.points_m[around.source, 0], seen.points_m[around.source, 1])
        grown = 1.0 + these.bleed_per_m * range_m
        grown[seen.ground[around.index]] *= these.ground_factor
        near = around.where(around.away < these.bleed_most_m)
        grown, of = grown[around.away < these.bleed_most_m], seen.thing[near.source]
        scaled = Spread(near.index, near.source, (near.away / grown).astype(np.float32))
        spread(scaled, these.bleed_m * width[:, 0], of, REACH_M)
        spread(behind, these.shadow_rad * width[:, 1], seen.thing[behind.source], BEHIND_RAD)


_SAME_PLACE_M: Final = 0.3
"""Distance within which a place was labelled dynamic in the frame before, metres."""

_MOST_THINGS: Final = 1024


def _movers(thing: NDArray[np.int64], motion: MotionCodes) -> dict[int, NDArray[np.int64]]:
    """Return the rows of each object that is labelled dynamic for the most part."""
    rows = np.flatnonzero(thing >= 0)
    rows = rows[np.argsort(thing[rows], kind="stable")]
    numbers, first = np.unique(thing[rows], return_index=True)
    parts = np.split(rows, first[1:]) if len(numbers) else []
    return {
        number: mine
        for number, mine in zip(numbers.tolist(), parts, strict=True)
        if 2 * np.count_nonzero(motion[mine] == DYNAMIC) > len(mine)
    }
