"""Shape persistence: tests if an object's shape was in the same place 0.4 to 2 s earlier and later.

Free space shows motion once an object has left its place by half a metre. A person who strolls
along a beam, a creeping car, and an object that stops or starts appear static to it, but their
shape moves. The shape is compared to the keyframes (`keyframes.py`) at other times. Points of a
static object meet observed points, even if more or less of the object is observed. Points of a
moved object meet none until they are shifted by one velocity. If no shift fits, the shape was no
rigid object, and there is no evidence. Keyframes in which another object occludes the place are
left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import Instance, Scene
from workers.contradiction.clamp import clamp01
from workers.contradiction.keyframes import Keyframes
from workers.contradiction.shape_matching import Cells, misfits
from workers.contradiction.temporal_context import COMPLETE_SHARE

NEAREST_S: Final = 0.4
"""Least time between a shape and a keyframe, seconds: sooner, a pedestrian has hardly moved."""

FARTHEST_S: Final = 2.05
"""Greatest time between them, seconds: two plus half a frame. Later no velocity lasts."""

IN_PLACE_M: Final = 0.1
MOVED_M: Final = 0.25
"""Mean distances of a shape to the nearest points, metres: in place up to the first, and
moved from the second on."""

MAX_DISTANCE_M: Final = 1.0
"""Upper bound of a point's distance, metres: a farther point is hidden, however far."""

BULK: Final = 0.8
"""Share of a shape's points, the nearest, that are compared: the others may be hidden."""

STATIC_SHARE: Final = 0.8
"""Share of the comparisons in which a static shape is in place. A lorry sets off slowly, and
most of its length still overlaps at first."""

MOVED_SHARE: Final = 0.3
"""Excess share of comparisons that show a moved shape away, over those that show it in place,
beyond the time at which it may have stopped or set off."""

OCCLUDED_SHARE: Final = 0.5
"""Occluded share of a shape from which on a keyframe is left out."""

FITS: Final = 0.5
FITS_NOT: Final = 0.8
"""Ratios of the distance after shifting to that before: one velocity explains the shape up to the
first, and does not from the second on."""

_HEIGHT_M: Final = 0.3
"""Margin above and below a shape, metres: an object that hangs above is no part of it."""

_SHAPES: Final = 5
_PAIRS: Final = 8
_POINTS: Final = 32
_COARSE: Final = 2
"""Stride over pairs and points in the coarse search among many velocities."""

_SLOW_M_PER_S: Final = 2.0
_STEPS_M_PER_S: Final = (0.5, 0.25, 0.125)
_FAST_M_PER_S: Final = _SLOW_M_PER_S + _STEPS_M_PER_S[1]
"""Speed of a track, m/s, above which velocities around its own are searched too."""

_GRID: Final = np.stack(
    np.meshgrid(*[np.arange(-_SLOW_M_PER_S, _SLOW_M_PER_S + 0.01, _STEPS_M_PER_S[0])] * 2), axis=-1
).reshape(-1, 2)
_ROUND: Final = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])


@dataclass(frozen=True, slots=True)
class ShapePersistence:
    """Evidence for the places of an object's shape, 0 to 1; on one side both 0 if nothing is known.

    Attributes:
        here_before: The shape was in the same place earlier.
        elsewhere_before: It was elsewhere earlier, and arrived by one velocity.
        here_after: The shape is in the same place later.
        elsewhere_after: It is elsewhere later, and departed by one velocity.
    """

    here_before: float = 0.0
    elsewhere_before: float = 0.0
    here_after: float = 0.0
    elsewhere_after: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """Sampled points of an instance, and the bounds of all its points; odom space."""

    stamp_ns: int
    places_m: NDArray[np.float64]
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """A shape, the index of the keyframe that it is compared to, and the signed time to it."""

    shape: _Shape
    number: int
    away_s: float


def shape_persistence_of(
    scene: Scene,
    members: Sequence[Instance],
    places_m: Sequence[NDArray[np.float64]],
    velocity_m_per_s: NDArray[np.float64],
    keyframes: Keyframes,
) -> ShapePersistence:
    """Test the places of an object's shape, earlier and later.

    Args:
        scene: Scene of the track.
        members: Instances of the track, in the order of their frames.
        places_m: Points (M, 3) of each instance, odom space.
        velocity_m_per_s: (2,) velocity of the path, around which fast objects are searched.
        keyframes: Keyframes of the scene.
    """
    shapes = _shapes(scene, members, places_m)
    here_before, elsewhere_before = _side(
        _pairs(shapes, keyframes, -1), velocity_m_per_s, keyframes
    )
    here_after, elsewhere_after = _side(_pairs(shapes, keyframes, 1), velocity_m_per_s, keyframes)
    return ShapePersistence(here_before, elsewhere_before, here_after, elsewhere_after)


def _side(
    pairs: Sequence[_Pair], velocity_m_per_s: NDArray[np.float64], keyframes: Keyframes
) -> tuple[float, float]:
    """Return the evidence for the same place, and for another one, on one side in time."""
    if not pairs:
        return 0.0, 0.0
    observed = _observed_around(pairs, keyframes, np.zeros(2), _SLOW_M_PER_S)
    unshifted_m = _misfit_m(pairs, observed, np.zeros((1, 2)))[:, 0]
    here = clamp01(
        (MOVED_M - float(np.quantile(unshifted_m, STATIC_SHARE))) / (MOVED_M - IN_PLACE_M)
    )
    away = clamp01(_away_share(pairs, unshifted_m) / MOVED_SHARE)
    if here == 1.0 or away == 0.0:
        return here, 0.0
    shifted_m = _best_m(pairs, observed, _GRID, _STEPS_M_PER_S[1:])
    if np.hypot(*velocity_m_per_s) > _FAST_M_PER_S:
        along = _observed_around(pairs, keyframes, velocity_m_per_s, sum(_STEPS_M_PER_S) * 2)
        near = velocity_m_per_s + _ROUND * _STEPS_M_PER_S[0] * 2
        shifted_m = min(shifted_m, _best_m(pairs, along, near, _STEPS_M_PER_S))
    fits = clamp01((FITS_NOT - shifted_m / float(unshifted_m.mean())) / (FITS_NOT - FITS))
    return here, (1.0 - here) * away * fits


def _away_share(pairs: Sequence[_Pair], unshifted_m: NDArray[np.float64]) -> float:
    """Return the excess share of pairs away, over pairs in place, beyond the best time limit.

    A shape in place at 1.5 s was not elsewhere at 0.5 s: it was partly observed then.
    """
    farthest_first = np.argsort([-abs(pair.away_s) for pair in pairs], kind="stable")
    away = np.clip((unshifted_m[farthest_first] - IN_PLACE_M) / (MOVED_M - IN_PLACE_M), 0.0, 1.0)
    return max(0.0, float(np.cumsum(2.0 * away - 1.0).max())) / len(pairs)


def _best_m(
    pairs: Sequence[_Pair],
    observed: Sequence[Cells],
    velocities: NDArray[np.float64],
    steps: Sequence[float],
) -> float:
    """Return the least misfit of some velocities, refined around the best one by each step."""
    misfit_m = _misfit_m(pairs[::_COARSE], observed[::_COARSE], velocities, every=_COARSE).mean(
        axis=0
    )
    for step in steps:
        velocities = velocities[int(misfit_m.argmin())] + _ROUND * step
        misfit_m = _misfit_m(pairs, observed, velocities).mean(axis=0)
    return float(misfit_m.min())


def _misfit_m(
    pairs: Sequence[_Pair],
    observed: Sequence[Cells],
    velocities: NDArray[np.float64],
    *,
    every: int = 1,
) -> NDArray[np.float64]:
    """Return the misfit (pairs, V) of each shape, shifted by each velocity; metres."""
    misfit_m = np.empty((len(pairs), len(velocities)))
    for number, (pair, seen) in enumerate(zip(pairs, observed, strict=True)):
        shape_m, shifts_m = pair.shape.places_m[::every, :2], velocities * pair.away_s
        misfit_m[number] = misfits(shape_m, shifts_m, seen, MAX_DISTANCE_M, BULK)
    return misfit_m


def _observed_around(
    pairs: Sequence[_Pair],
    keyframes: Keyframes,
    velocity_m_per_s: NDArray[np.float64],
    spread_m_per_s: float,
) -> list[Cells]:
    """Return the observed places around each shape, shifted by a velocity within a spread."""
    observed = []
    for pair in pairs:
        shift_m = np.append(velocity_m_per_s * pair.away_s, 0.0)
        margin_m = np.full(3, MAX_DISTANCE_M + spread_m_per_s * abs(pair.away_s))
        margin_m[2] = _HEIGHT_M
        low_m, high_m = pair.shape.low_m + shift_m, pair.shape.high_m + shift_m
        observed.append(keyframes.near(pair.number, low_m - margin_m, high_m + margin_m))
    return observed


def _pairs(shapes: Sequence[_Shape], keyframes: Keyframes, side: int) -> list[_Pair]:
    """Return evenly spread pairs of shapes and keyframes, earlier (side -1) or later (side 1)."""
    pairs = []
    for shape in shapes:
        away_s = (keyframes.stamps_ns - shape.stamp_ns) / NS_PER_S
        due = (side * away_s >= NEAREST_S) & (side * away_s <= FARTHEST_S)
        pairs += [_Pair(shape, int(each), float(away_s[each])) for each in np.flatnonzero(due)]
    chosen = [pairs[each] for each in _spread(len(pairs), _PAIRS)]
    return [each for each in chosen if _is_visible(each, keyframes)]


def _is_visible(pair: _Pair, keyframes: Keyframes) -> bool:
    """Return whether the place of a shape is visible in the keyframe."""
    return keyframes.occluded_share(pair.number, pair.shape.places_m) < OCCLUDED_SHARE


def _shapes(
    scene: Scene, members: Sequence[Instance], places_m: Sequence[NDArray[np.float64]]
) -> list[_Shape]:
    """Return shapes of complete instances, evenly spread over the track."""
    points = np.array([len(each) for each in places_m])
    whole = np.flatnonzero(points >= COMPLETE_SHARE * np.median(points))
    shapes = []
    for each in whole[_spread(len(whole), _SHAPES)]:
        placed_m = places_m[each]
        some_m = np.ascontiguousarray(placed_m[:: max(1, len(placed_m) // _POINTS)])
        stamp_ns = scene.frames[members[each].frame_index].stamp_ns
        shapes.append(_Shape(stamp_ns, some_m, placed_m.min(axis=0), placed_m.max(axis=0)))
    return shapes


def _spread(count: int, most: int) -> NDArray[np.int64]:
    """Return at most `most` of `count` indices, evenly spread and including both ends."""
    even = np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)
    return np.unique(even)
