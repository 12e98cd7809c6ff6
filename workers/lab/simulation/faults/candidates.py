"""Candidates of planted failures: the actors of a scene that can carry each kind, by visibility."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from schemas.arrays import Mask
from workers.lab.simulation.faults.faults import DYNAMIC, STATIC, TrueFrame, ghost_points
from workers.lab.simulation.faults.plan import FailureKind
from workers.lab.simulation.models.kinds import StreetClass

ENOUGH_POINTS: Final = 30
"""Points of an object per frame: a failure needs 25, and only every second frame is examined."""

LOOK_EVERY: Final = 2

RARE: Final = frozenset({"animal", "bus", "cyclist", "motorcycle", "trailer", "tram", "van"})
"""Names of classes that may be missing in a model's training data."""

REGRESSED: Final = frozenset({"cyclist", "motorcycle", "truck"})
"""Names of classes that the new version of the model labels wrong."""

SLOW_M_PER_S: Final = 1.0
LONG_M: Final = 18.0
TOUCHING_M: Final = 0.4
_SWAP_WITHIN_M: Final = 15.0
_FAR_M: Final = 15.0
_GHOST_RANGE_M: Final = (6.0, 25.0)
_GHOST_TRIES: Final = 24


class Actor(Protocol):
    """An object that can carry a failure."""

    @property
    def street_class(self) -> StreetClass:
        """Its class."""
        ...

    @property
    def size_m(self) -> tuple[float, float, float]:
        """Length, width and height, metres."""
        ...


class Scenery(Protocol):
    """Objects of a log and the seed of what is drawn there: a simulated street, or a real drive."""

    @property
    def seed(self) -> int:
        """Seed of what is drawn."""
        ...

    @property
    def actors(self) -> Sequence[Actor]:
        """Its objects, by the number that truth gives them."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class SceneVisibility:
    """Visibility of every actor in some frames of a scene.

    Attributes:
        street: The street, or the drive.
        times_s: (L,) times of the examined frames.
        step_s: Time between them.
        points: (L, A) returns of each actor.
        motion: (L, A) its true motion; 0 where it is not visible.
        centre_m: (L, A, 3) mean of its returns, world space; NaN where it is not visible.
        nearest_m: (L, A) range of its nearest return.
        gap_m: (L, A) tenth percentile of the distance from its returns to static structure; inf
            where it is not visible.
        frames: The frames themselves.
    """

    street: Scenery
    times_s: NDArray[np.float64]
    step_s: float
    points: NDArray[np.int64]
    motion: NDArray[np.uint8]
    centre_m: NDArray[np.float64]
    nearest_m: NDArray[np.float64]
    gap_m: NDArray[np.float64]
    frames: tuple[TrueFrame, ...]


@dataclass(frozen=True, slots=True)
class Candidate:
    """An object that can carry a failure, with its time window.

    Attributes:
        track: Index into the street's actors; -1 a place.
        start_s: Start of sufficient visibility.
        lasts_s: Duration of sufficient visibility.
        other_track: Partner in a swap; -1 none.
        place_m: Position of a ghost, world space.
        range_m: Range beyond which the model labels no mover; 0 no limit.
        because: Reason for an error of the self-supervised stream too; empty without one.
        class_name: Its class.
    """

    track: int
    start_s: float
    lasts_s: float
    other_track: int = -1
    place_m: tuple[float, float, float] | None = None
    range_m: float = 0.0
    because: str = ""
    class_name: str = ""


def measure_visibility(
    street: Scenery,
    frame_at: Callable[[int], TrueFrame],
    *,
    from_s: float,
    to_s: float,
    period_s: float,
) -> SceneVisibility:
    """Measure the visibility of every actor in every second frame of an interval of a log."""
    numbers = range(round(from_s / period_s), round(to_s / period_s), LOOK_EVERY)
    frames = tuple(frame_at(number) for number in numbers)
    shape = (len(frames), len(street.actors))
    points = np.zeros(shape, np.int64)
    motion = np.zeros(shape, np.uint8)
    centre_m = np.full((*shape, 3), np.nan)
    nearest_m, gap_m = np.full(shape, np.inf), np.full(shape, np.inf)
    for i, frame in enumerate(frames):
        standing = (frame.track < 0) & (frame.ground == 0)
        structure = cKDTree(frame.points_m[standing]) if standing.any() else None
        world = frame.points_m @ frame.world_from_sensor[:3, :3].T + frame.world_from_sensor[:3, 3]
        for track in np.unique(frame.track[frame.track >= 0]).tolist():
            mine = np.flatnonzero(frame.track == track)
            points[i, track] = len(mine)
            motion[i, track] = int(np.bincount(frame.motion[mine]).argmax())
            if len(mine) < ENOUGH_POINTS:
                continue
            centre_m[i, track] = world[mine].mean(axis=0)
            range_m = np.hypot(frame.points_m[mine, 0], frame.points_m[mine, 1])
            nearest_m[i, track] = range_m.min()
            if motion[i, track] == DYNAMIC and structure is not None:
                some = mine[:: max(1, len(mine) // 200)]
                gaps, _ = structure.query(frame.points_m[some])
                gap_m[i, track] = np.quantile(gaps, 0.1)
    times_s = np.array([frame.time_s for frame in frames])
    return SceneVisibility(
        street, times_s, LOOK_EVERY * period_s, points, motion, centre_m, nearest_m, gap_m, frames
    )


def candidates_of(
    view: SceneVisibility, kind: FailureKind, *, common_mode: bool = False
) -> list[Candidate]:
    """Find the objects of a scene that can carry a failure of this kind, in a fixed order."""
    return list(_candidates(view, kind, common_mode))


def _candidates(view: SceneVisibility, kind: FailureKind, common_mode: bool) -> Iterator[Candidate]:
    seen = view.points >= ENOUGH_POINTS
    moves, stands = seen & (view.motion == DYNAMIC), seen & (view.motion == STATIC)
    names = [actor.street_class.name.lower() for actor in view.street.actors]

    def runs(usable: Mask, wanted: Callable[[str], bool] = lambda name: True) -> list[Candidate]:
        return [
            Candidate(track, *run, class_name=names[track])
            for track in range(len(names))
            if wanted(names[track]) and (run := _longest_run(view, usable[:, track])) is not None
        ]

    if kind is FailureKind.MISSED_MOVER:
        for each in runs(moves):
            because = _why_missed(view, each)
            if because or not common_mode:
                yield replace(each, because=because)
    elif kind is FailureKind.UNSEEN_CLASS:
        yield from runs(moves, lambda name: name in RARE)
    elif kind is FailureKind.VERSION_REGRESSION:
        yield from runs(moves, lambda name: name in REGRESSED)
    elif kind is FailureKind.MISSED_PEDESTRIAN:
        yield from runs(moves, lambda name: name == StreetClass.PEDESTRIAN.name.lower())
    elif kind is FailureKind.PARKED_CALLED_MOVING:
        yield from runs(stands)
    elif kind is FailureKind.FLICKER:
        yield from runs(moves)
    elif kind is FailureKind.RANGE_LIMIT:
        for each in runs(moves):
            nearest_m = float(view.nearest_m[moves[:, each.track], each.track].min())
            if nearest_m > _FAR_M:
                yield replace(each, range_m=round(0.95 * nearest_m, 1))
    elif kind is FailureKind.LATE_DETECTION:
        for each in runs(moves):
            if each.start_s > view.times_s[0] and not view.points[0, each.track]:
                yield each
    elif kind is FailureKind.LABEL_SWAP:
        yield from _swaps(view, runs(moves), runs(stands))
    elif kind is FailureKind.GHOST_MOVER:
        yield from _ghosts(view)


def _longest_run(view: SceneVisibility, usable: Mask) -> tuple[float, float] | None:
    """Return start and length of the longest usable interval of an object; None without any."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(np.int8), [0]])))
    if not len(edges):
        return None
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    start_s = float(view.times_s[starts[longest]])
    return start_s, float(ends[longest] - starts[longest]) * view.step_s


def _why_missed(view: SceneVisibility, candidate: Candidate) -> str:
    """Return the reason why the self-supervised stream misses a mover too; empty without one."""
    track = candidate.track
    if view.street.actors[track].size_m[0] > LONG_M:
        return "long"
    until_s = candidate.start_s + candidate.lasts_s - 1e-6
    mine = (view.times_s >= candidate.start_s) & (view.times_s < until_s)
    path = view.centre_m[mine, track]
    path = path[np.isfinite(path).all(axis=1)]
    if candidate.class_name == StreetClass.PEDESTRIAN.name.lower() and len(path) > 2:
        speed = float(np.hypot(*(path[-1] - path[0])[:2])) / ((len(path) - 1) * view.step_s)
        if speed < SLOW_M_PER_S:
            return "slow"
    if float(np.median(view.gap_m[mine, track])) < TOUCHING_M:
        return "touching"
    return ""


def _swaps(
    view: SceneVisibility, moving: list[Candidate], standing: list[Candidate]
) -> Iterator[Candidate]:
    """Yield pairs of a mover and a nearby standing object, while both are visible."""
    for mover in moving:
        for other in standing:
            start_s = max(mover.start_s, other.start_s)
            end_s = min(mover.start_s + mover.lasts_s, other.start_s + other.lasts_s)
            during = (view.times_s >= start_s - 1e-6) & (view.times_s < end_s - 1e-6)
            if not during.any():
                continue
            apart = view.centre_m[during, mover.track] - view.centre_m[during, other.track]
            if float(np.hypot(apart[:, 0], apart[:, 1]).max()) < _SWAP_WITHIN_M:
                yield Candidate(
                    mover.track,
                    start_s,
                    end_s - start_s,
                    other_track=other.track,
                    class_name=mover.class_name,
                )


def _ghosts(view: SceneVisibility) -> Iterator[Candidate]:
    """Yield places of static structure that is visible in every examined frame."""
    first = view.frames[0]
    range_m = np.hypot(first.points_m[:, 0], first.points_m[:, 1])
    low, high = _GHOST_RANGE_M
    usable = (first.track < 0) & (first.ground == 0) & (range_m > low) & (range_m < high)
    usable &= np.abs(first.points_m[:, 2]) < 2.0  # where road users are
    places = np.flatnonzero(usable)
    rng = np.random.default_rng([view.street.seed, first.index])
    for point in rng.choice(places, min(_GHOST_TRIES, len(places)), replace=False).tolist():
        pose = first.world_from_sensor
        x, y, z = (pose[:3, :3] @ first.points_m[point] + pose[:3, 3]).tolist()
        place_m = (round(x, 2), round(y, 2), round(z, 2))
        seen = np.array([int(ghost_points(f, place_m).sum()) >= ENOUGH_POINTS for f in view.frames])
        run = _longest_run(view, seen)
        if run is not None:
            what = StreetClass(int(first.class_id[point])).name.lower()
            yield Candidate(-1, *run, place_m=place_m, class_name=what)
