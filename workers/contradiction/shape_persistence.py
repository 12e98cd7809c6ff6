"""Whether the very shape of a thing lies where it is, or elsewhere, a while before and after.

Free space sees a place left once it is empty by half a metre: who strolls along a beam, a car that
creeps and what stops or starts stand for it. But their shape goes. Laid over what is seen at other
times, the points of what stands meet points, however much more or less of it is seen; those of what
went meet none, and do so once they are shifted by one velocity. Where they meet none however they
are shifted, the thing was none: then nothing is said. Moments at which another thing stands before
its place are not asked.
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
from workers.contradiction.temporal_context import MOST

NEAREST_S: Final = 0.4
"""Sooner, who walks is where he was."""

FARTHEST_S: Final = 2.05
"""Later, nothing goes straight on; two seconds and half a frame."""

HERE_M: Final = 0.1
AWAY_M: Final = 0.25
"""How far from the nearest points the bulk of a shape lies that stands, and that went."""

HIDDEN_M: Final = 1.0
"""No point counts as farther: it is hidden, and by how much says nothing."""

BULK: Final = 0.8
"""Of the points of a shape, the nearest: the rest was hidden then."""

ALWAYS: Final = 0.8
"""Of the times it is asked, so many lie where it stands: a lorry sets off slowly, and by its own
length little seems to go at first."""

OFTEN: Final = 0.3
"""Of the times it is asked, what went is away in so many more than it is here, beyond the moment at
which it may have stopped or set off."""

HIDDEN: Final = 0.5
"""Of a shape, so much behind something else leaves too little to look for."""

FITS: Final = 0.5
FITS_NOT: Final = 0.8
"""Shares of the distance that shifting leaves, of a thing that went and of another one."""

_HEIGHT_M: Final = 0.3
"""Over and under a shape: what hangs above it is no part of it."""

_SHAPES: Final = 5
_PAIRS: Final = 8
_POINTS: Final = 32
_COARSE: Final = 2
"""Of pairs and points, every second one is enough to choose among many velocities."""

_SLOW_M_PER_S: Final = 2.0
_STEPS_M_PER_S: Final = (0.5, 0.25, 0.125)
_GOES_M_PER_S: Final = _SLOW_M_PER_S + _STEPS_M_PER_S[1]
"""From here on its own path says where to look."""

_GRID: Final = np.stack(
    np.meshgrid(*[np.arange(-_SLOW_M_PER_S, _SLOW_M_PER_S + 0.01, _STEPS_M_PER_S[0])] * 2), axis=-1
).reshape(-1, 2)
_ROUND: Final = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])


@dataclass(frozen=True, slots=True)
class ShapePersistence:
    """How sure it is where a thing was and will be, 0 to 1; both 0 where nothing is known.

    Attributes:
        here_before: Its shape lay where it lies now.
        elsewhere_before: It lay elsewhere, and came by one velocity.
        here_after: It stays.
        elsewhere_after: It goes on by one velocity.
    """

    here_before: float = 0.0
    elsewhere_before: float = 0.0
    here_after: float = 0.0
    elsewhere_after: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """Some points of an instance over the ground, and their heights: odom space."""

    stamp_ns: int
    places_m: NDArray[np.float64]
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """A shape, the glance it is laid over, and how much later that was taken."""

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
    """Say where the shape of a thing was, and where it will be.

    Args:
        scene: Where its track was found.
        members: Its instances, in the order of their frames.
        places_m: (M, 3) their points, odom space.
        velocity_m_per_s: (2,) of its path: where to look for what is fast.
        keyframes: Of the scene.
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
    """How sure the shapes lie where they are, and elsewhere, on one side in time."""
    if not pairs:
        return 0.0, 0.0
    about = _about(pairs, keyframes, np.zeros(2), _SLOW_M_PER_S)
    as_is_m = _misfit_m(pairs, about, np.zeros((1, 2)))[:, 0]
    here = clamp01((AWAY_M - float(np.quantile(as_is_m, ALWAYS))) / (AWAY_M - HERE_M))
    away = clamp01(_away_share(pairs, as_is_m) / OFTEN)
    if here == 1.0 or away == 0.0:
        return here, 0.0
    shifted_m = _best_m(pairs, about, _GRID, _STEPS_M_PER_S[1:])
    if np.hypot(*velocity_m_per_s) > _GOES_M_PER_S:
        along = _about(pairs, keyframes, velocity_m_per_s, sum(_STEPS_M_PER_S) * 2)
        near = velocity_m_per_s + _ROUND * _STEPS_M_PER_S[0] * 2
        shifted_m = min(shifted_m, _best_m(pairs, along, near, _STEPS_M_PER_S))
    fits = clamp01((FITS_NOT - shifted_m / float(as_is_m.mean())) / (FITS_NOT - FITS))
    return here, (1.0 - here) * away * fits


def _away_share(pairs: Sequence[_Pair], as_is_m: NDArray[np.float64]) -> float:
    """How many more of all pairs lie away than here, beyond the moment from which on most do.

    What lies where it is a second and a half away was not elsewhere half a second away: it was half
    seen then.
    """
    farthest_first = np.argsort([-abs(pair.away_s) for pair in pairs], kind="stable")
    away = np.clip((as_is_m[farthest_first] - HERE_M) / (AWAY_M - HERE_M), 0.0, 1.0)
    return max(0.0, float(np.cumsum(2.0 * away - 1.0).max())) / len(pairs)


def _best_m(
    pairs: Sequence[_Pair],
    about: Sequence[Cells],
    velocities: NDArray[np.float64],
    steps: Sequence[float],
) -> float:
    """Least misfit of some velocities, and of those about the best one in ever finer steps."""
    misfit_m = _misfit_m(pairs[::_COARSE], about[::_COARSE], velocities, every=_COARSE).mean(axis=0)
    for step in steps:
        velocities = velocities[int(misfit_m.argmin())] + _ROUND * step
        misfit_m = _misfit_m(pairs, about, velocities).mean(axis=0)
    return float(misfit_m.min())


def _misfit_m(
    pairs: Sequence[_Pair],
    about: Sequence[Cells],
    velocities: NDArray[np.float64],
    *,
    every: int = 1,
) -> NDArray[np.float64]:
    """(pairs, V) how far the bulk of shapes that go so lies from what is seen."""
    misfit_m = np.empty((len(pairs), len(velocities)))
    for number, (pair, seen) in enumerate(zip(pairs, about, strict=True)):
        shape_m, shifts_m = pair.shape.places_m[::every, :2], velocities * pair.away_s
        misfit_m[number] = misfits(shape_m, shifts_m, seen, HIDDEN_M, BULK)
    return misfit_m


def _about(
    pairs: Sequence[_Pair],
    keyframes: Keyframes,
    velocity_m_per_s: NDArray[np.float64],
    spread_m_per_s: float,
) -> list[Cells]:
    """What is seen about shapes that go so, more or less."""
    about = []
    for pair in pairs:
        shift_m = np.append(velocity_m_per_s * pair.away_s, 0.0)
        margin_m = np.full(3, HIDDEN_M + spread_m_per_s * abs(pair.away_s))
        margin_m[2] = _HEIGHT_M
        low_m, high_m = pair.shape.low_m + shift_m, pair.shape.high_m + shift_m
        about.append(keyframes.near(pair.number, low_m - margin_m, high_m + margin_m))
    return about


def _pairs(shapes: Sequence[_Shape], keyframes: Keyframes, side: int) -> list[_Pair]:
    """Shapes and the frames they are laid over, spread evenly; before: side -1, after: 1."""
    pairs = []
    for shape in shapes:
        away_s = (keyframes.stamps_ns - shape.stamp_ns) / NS_PER_S
        due = (side * away_s >= NEAREST_S) & (side * away_s <= FARTHEST_S)
        pairs += [_Pair(shape, int(each), float(away_s[each])) for each in np.flatnonzero(due)]
    chosen = [pairs[each] for each in _spread(len(pairs), _PAIRS)]
    return [each for each in chosen if _is_asked(each, keyframes)]


def _is_asked(pair: _Pair, keyframes: Keyframes) -> bool:
    """Whether the place of a shape could be seen in the frame it is laid over."""
    return keyframes.hidden_share(pair.number, pair.shape.places_m) < HIDDEN


def _shapes(
    scene: Scene, members: Sequence[Instance], places_m: Sequence[NDArray[np.float64]]
) -> list[_Shape]:
    """Some instances of a track that are no scraps, from its first to its last."""
    points = np.array([len(each) for each in places_m])
    whole = np.flatnonzero(points >= MOST * np.median(points))
    shapes = []
    for each in whole[_spread(len(whole), _SHAPES)]:
        placed_m = places_m[each]
        some_m = np.ascontiguousarray(placed_m[:: max(1, len(placed_m) // _POINTS)])
        stamp_ns = scene.frames[members[each].frame_index].stamp_ns
        shapes.append(_Shape(stamp_ns, some_m, placed_m.min(axis=0), placed_m.max(axis=0)))
    return shapes


def _spread(count: int, most: int) -> NDArray[np.int64]:
    """Indices of at most so many of some, evenly spread, ends included."""
    even = np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)
    return np.unique(even)
