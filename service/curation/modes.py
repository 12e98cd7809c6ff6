"""Failure modes: strong contradicting tracks of a fleet, grouped by what is alike. Pure.

A mode has one kind of contradiction and one class. Modes need no memory of their own. The growth of
the fleet is repeated at 128, 256, 512, ... tracks. Tracks within the reach of a mode join the
nearest one. HDBSCAN (scikit-learn, extra `curation`) splits the others of each kind and class where
they are apart, and they form new modes. A mode therefore keeps its id, its name and its members as
the fleet grows.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.events import TrackSummary
from service.curation.candidates import Candidate
from service.curation.ranking import is_reason
from service.errors import UsageError

FIRST_GROUPED: Final = 128
"""Tracks from which on modes are formed; new ones are sought each time that they have doubled."""

MOST_GROUPED: Final = 4096
"""Tracks of one kind and class that are grouped at most, the first of those that are of no mode."""

FEWEST_MEMBERS: Final = 8
"""Tracks of a new mode at least."""

NEIGHBOURS: Final = 3
"""Tracks that must be near for a track to be in the middle of a mode."""

REACH: Final = 1.5
"""Reach of a mode, in distances of its farthest first member from its centre."""

SPEED_WEIGHT: Final = 0.5
FAR_M: Final = 20.0
LONGEST_S: Final = 2.0
"""Scales of the features: the speed counts half, 20 m as much as one unit of the logarithm of a
size, and a duration in seconds up to two.
"""

NONE: Final = -1
"""Number of the mode of a track that is of none."""

Features = NDArray[np.float64]
Labels = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ModeTrack:
    """A strong track on which the supervised stream errs, in its scene.

    Attributes:
        candidate: Its scene.
        track: The track.
    """

    candidate: Candidate
    track: TrackSummary

    @property
    def key(self) -> str:
        """Its scene and number."""
        return f"{self.candidate.scene.scene_id}#{self.track.track_id}"


@dataclass(frozen=True, slots=True)
class Mode:
    """A failure mode.

    Attributes:
        mode_id: Stays as the fleet grows.
        name: Its first members in a few words; stays too.
        members: Its tracks, in the order of the fleet.
    """

    mode_id: str
    name: str
    members: tuple[ModeTrack, ...]


def tracks_of(candidates: Iterable[Candidate]) -> list[ModeTrack]:
    """Return the tracks that are a reason for a review, in the order in which scenes came."""
    found = [
        ModeTrack(each, track)
        for each in candidates
        for track in each.scene.tracks
        if is_reason(track.strength, track.wrong)
    ]
    return sorted(found, key=lambda each: (each.candidate.seq, each.key))


@dataclass(frozen=True, slots=True, eq=False)
class _Formed:
    """Lasting facts of a mode, from its first members.

    Attributes:
        mode_id: Digest of its kind, class and first member.
        name: Of its first members.
        sort: Its kind of contradiction and its class.
        centre: Mean of its first members.
        reach: Distance from the centre within which tracks join it.
    """

    mode_id: str
    name: str
    sort: str
    centre: Features
    reach: float


def modes_of(tracks: Sequence[ModeTrack]) -> list[Mode]:
    """Group the tracks of a fleet into modes, the largest first.

    Args:
        tracks: In the order in which they came, as `tracks_of` returns them.

    Returns:
        No mode for fewer than `FIRST_GROUPED` tracks. Tracks that are like few others are of none.

    Raises:
        UsageError: If scikit-learn is not installed.
    """
    features = _features([each.track for each in tracks])
    sorts = np.array([_sort_of(each.track) for each in tracks], object)
    labels, formed = np.full(len(tracks), NONE, np.int64), list[_Formed]()
    size = FIRST_GROUPED
    while size <= len(tracks):
        _join(labels[:size], features, sorts, formed)
        for sort in sorted(set(sorts[:size].tolist())):
            rest = np.flatnonzero((sorts[:size] == sort) & (labels[:size] == NONE))[:MOST_GROUPED]
            for members in _grouped(features, rest):
                labels[members] = len(formed)
                formed.append(_formed(members, features, tracks))
        size *= 2
    _join(labels, features, sorts, formed)
    labelled = list(zip(tracks, labels.tolist(), strict=True))
    found = [
        Mode(mode.mode_id, mode.name, tuple(each for each, of in labelled if of == number))
        for number, mode in enumerate(formed)
    ]
    return sorted(found, key=lambda mode: (-len(mode.members), mode.mode_id))


def _sort_of(track: TrackSummary) -> str:
    return f"{track.kind} {track.class_name}"


def _features(tracks: Sequence[TrackSummary]) -> Features:
    """Return (M, 6) features; a unit is a factor of e of a size, or 20 m of distance."""
    numbers = [
        (
            np.log(max(track.size_m[0], 0.2)),
            np.log(max(track.size_m[2], 0.2)),
            SPEED_WEIGHT * np.log1p(track.speed_m_per_s),
            track.range_m / FAR_M,
            min(LONGEST_S, (track.last_ns - track.first_ns) / NS_PER_S),
            track.strength,
        )
        for track in tracks
    ]
    return np.array(numbers, np.float64).reshape(len(tracks), 6)


def _join(
    labels: Labels, features: Features, sorts: NDArray[np.object_], formed: Sequence[_Formed]
) -> None:
    """Give the tracks without a mode the nearest one of their sort within whose reach they are."""
    free = np.flatnonzero(labels == NONE)
    nearest_away = np.full(len(free), np.inf)
    for number, mode in enumerate(formed):
        away = np.linalg.norm(features[free] - mode.centre, axis=1)
        inside = (away < nearest_away) & (away <= mode.reach) & (sorts[free] == mode.sort)
        labels[free[inside]] = number
        nearest_away[inside] = away[inside]


def _grouped(features: Features, rest: Labels) -> list[Labels]:
    """Group tracks of one kind and class; return the numbers of the tracks of each group.

    What HDBSCAN leaves between groups goes to the nearest one. Without groups that are apart, all
    tracks are one group.
    """
    try:
        from sklearn.cluster import HDBSCAN
    except ImportError:
        raise UsageError("modes need scikit-learn: pip install 'counterpoint[curation]'") from None
    if len(rest) < FEWEST_MEMBERS:
        return []
    found = np.full(len(rest), NONE)
    if len(rest) >= 2 * FEWEST_MEMBERS:
        found = HDBSCAN(
            min_cluster_size=FEWEST_MEMBERS,
            min_samples=NEIGHBOURS,
            allow_single_cluster=True,
            copy=True,
        ).fit_predict(features[rest])
    groups = int(found.max()) + 1
    if groups == 0:
        return [rest]
    centres = np.stack([features[rest[found == each]].mean(axis=0) for each in range(groups)])
    between = np.flatnonzero(found == NONE)
    away = np.linalg.norm(features[rest[between], None] - centres[None], axis=2)
    found[between] = away.argmin(axis=1)
    return [rest[found == each] for each in range(groups)]


def _formed(members: Labels, features: Features, tracks: Sequence[ModeTrack]) -> _Formed:
    centre = features[members].mean(axis=0)
    away = np.linalg.norm(features[members] - centre, axis=1)
    first = tracks[int(members[0])]
    sort = _sort_of(first.track)
    digest = sha256(f"{sort} {first.key}".encode()).hexdigest()[:8]
    return _Formed(
        mode_id=f"mode-{digest}",
        name=_name_of([tracks[at].track for at in members.tolist()]),
        sort=sort,
        centre=centre,
        reach=REACH * float(away.max()) + 1e-6,
    )


def _name_of(tracks: Sequence[TrackSummary]) -> str:
    """Name a mode by its kind and class and its middle size, distance and speed."""
    kind, class_name = tracks[0].kind, tracks[0].class_name
    length_m, range_m, speed = (
        float(np.median(values))
        for values in (
            [track.size_m[0] for track in tracks],
            [track.range_m for track in tracks],
            [track.speed_m_per_s for track in tracks],
        )
    )
    moves = f"{speed:.0f} m/s" if speed > 0 else "speed unmeasured"
    what = f"{class_name or 'any class'}, {kind.replace('_', ' ')}"
    return f"{what}, {length_m:.1f} m long, {range_m:.0f} m away, {moves}"
