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

from schemas.arrays import Mask, Points, Transform
from workers.lab.labels.borders import BEHIND_RAD, INSIDE_M, REACH_M, Borders, Spread

STATIC: Final = 1
DYNAMIC: Final = 2

MotionCodes = NDArray[np.uint8]
ClassIds = NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """Strength of each kind of noise.

    Attributes:
        bleed_m: Median width by which an object's label bleeds onto what is around it, metres.
        bleed_spread: Standard deviation of the logarithm of that width between objects.
        bleed_per_m: Growth of the width with the range of the object, per metre.
        ground_factor: Factor of the width on the ground, where bleeding is narrower.
        shadow_rad: Median width by which it bleeds onto what is behind its outline, radians.
        inside_m: Median width by which its border takes the label of the surroundings, metres.
        blobs_per_frame: Mean number of new blobs of a wrong class in a frame.
        blob_m: Least and largest radius of a blob, metres.
        blob_frames: Longest life of a blob, frames; shorter than any failure.
        blob_moving_share: Share of blobs that are labelled moving too.
        flicker_from_m: Range from which an object's motion flickers, metres.
        flicker_full_m: Range from which it flickers most.
        flicker_share: Largest share of frames in which a far mover is labelled static.
        late_share: Share of frames in which the label of a mover is that of the frame before.
        rest_frames: Frames of an object without flicker after a wrong one. Noise is then wrong on
            an object for less than half a second in any three, which is no failure.
        bleed_most_m: Largest width of bleeding; beyond half a metre it would be an object.
    """

    bleed_m: float = 0.2
    bleed_spread: float = 0.6
    bleed_per_m: float = 0.015
    ground_factor: float = 0.9
    shadow_rad: float = float(np.radians(0.2))
    inside_m: float = 0.07
    blobs_per_frame: float = 1.0
    blob_m: tuple[float, float] = (0.25, 1.0)
    blob_frames: int = 4
    blob_moving_share: float = 0.4
    flicker_from_m: float = 25.0
    flicker_full_m: float = 60.0
    flicker_share: float = 0.10
    late_share: float = 0.04
    rest_frames: int = 7
    bleed_most_m: float = 0.45


REAL: Final = NoiseSettings()
"""Noise of the size that networks show at borders and at range on real drives."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenFrame:
    """Points, objects and pose of one frame, on which the noise depends.

    Attributes:
        points_m: (N, 3) points in sensor space.
        thing: (N,) number of the object that a point belongs to, -1 none.
        ground: (N,) true on the ground.
        world_from_sensor: (4, 4) pose of the sensor in any world that rests.
        borders: Borders of its objects.
    """

    points_m: Points
    thing: NDArray[np.int64]
    ground: Mask
    world_from_sensor: Transform
    borders: Borders


@dataclass(frozen=True, slots=True)
class _Blob:
    world_m: tuple[float, float, float]
    radius_m: float
    last_frame: int
    class_id: int
    moving: bool


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
    _blobs: list[_Blob] = field(default_factory=list)
    _before: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    _wrong_at: dict[int, int] = field(default_factory=dict)

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
        self._blob(seen, motion, class_id, rng)
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

    def _blob(
        self, seen: SeenFrame, motion: MotionCodes, class_id: ClassIds, rng: np.random.Generator
    ) -> None:
        """Give blobs of points of no object a wrong class, for a moment."""
        these = self.settings
        self._blobs = [each for each in self._blobs if each.last_frame >= self._count]
        free = np.flatnonzero((seen.thing < 0) & (np.abs(seen.points_m).sum(axis=1) > 0))
        born = int(rng.poisson(these.blobs_per_frame)) if len(free) else 0
        pose = seen.world_from_sensor
        for _ in range(born):
            x, y, z = pose[:3, :3] @ seen.points_m[rng.choice(free)] + pose[:3, 3]
            self._blobs.append(
                _Blob(
                    world_m=(float(x), float(y), float(z)),
                    radius_m=float(rng.uniform(*these.blob_m)),
                    last_frame=self._count + int(rng.integers(these.blob_frames)),
                    class_id=int(rng.choice(self.blob_classes)),
                    moving=bool(rng.random() < these.blob_moving_share),
                )
            )
        for each in self._blobs:
            middle = (np.array(each.world_m) - pose[:3, 3]) @ pose[:3, :3]
            away = seen.points_m - middle.astype(np.float32)
            mine = np.einsum("ij,ij->i", away, away) < each.radius_m**2
            mine &= seen.thing < 0
            class_id[mine] = each.class_id
            if each.moving:
                motion[mine] = DYNAMIC


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
