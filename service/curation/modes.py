"""Failure modes: strong contradicting tracks of a fleet, grouped by what is alike. Pure.

Modes need no memory of their own. The growth of the fleet is repeated at 128, 256, 512, ... tracks.
Tracks within the reach of a mode join it, and HDBSCAN (scikit-learn, extra `curation`) groups the
others of each kind of contradiction into new modes. A mode therefore keeps its id, its name and its
members as the fleet grows.
"""

from collections import Counter
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
"""Tracks of one kind that are grouped at most, the first of those that are of no mode."""

FEWEST_MEMBERS: Final = 8
"""Tracks of a new mode at least."""

NEIGHBOURS: Final = 3
"""Tracks that must be near for a track to be in the middle of a mode."""

REACH: Final = 0.9
"""Share of the first members that are within the reach of a mode."""

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
        mode_id: Digest of its first member.
        name: Of its first members.
        kind: Kind of contradiction.
        centre: Mean of its first members.
        reach: Distance from the centre within which tracks join it.
    """

    mode_id: str
    name: str
    kind: str
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
    kinds = np.array([each.track.kind for each in tracks], object)
    labels, formed = np.full(len(tracks), NONE, np.int64), list[_Formed]()
    size = FIRST_GROUPED
    while size <= len(tracks):
        _join(labels[:size], features, kinds, formed)
        for kind in sorted(set(kinds[:size].tolist())):
            rest = np.flatnonzero((kinds[:size] == kind) & (labels[:size] == NONE))[:MOST_GROUPED]
            for members in _grouped(features, rest):
                labels[members] = len(formed)
                formed.append(_formed(members, features, tracks))
        size *= 2
    _join(labels, features, kinds, formed)
    labelled = list(zip(tracks, labels.tolist(), strict=True))
    found = [
        Mode(mode.mode_id, mode.name, tuple(each for each, of in labelled if of == number))
        for number, mode in enumerate(formed)
    ]
    return sorted(found, key=lambda mode: (-len(mode.members), mode.mode_id))


def _features(tracks: Sequence[TrackSummary]) -> Features:
    """Return (M, F) features; a unit is a factor of e of a size, 20 m of distance, or a class."""
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
    names, classes = np.unique([track.class_name for track in tracks], return_inverse=True)
    apart = np.eye(len(names))[classes] / np.sqrt(2.0)
    return np.hstack([np.array(numbers, np.float64).reshape(len(tracks), 6), apart])


def _join(
    labels: Labels, features: Features, kinds: NDArray[np.object_], formed: Sequence[_Formed]
) -> None:
    """Give the tracks without a mode the one whose reach they are deepest in."""
    free = np.flatnonzero(labels == NONE)
    best = np.ones(len(free))
    for number, mode in enumerate(formed):
        depth = np.linalg.norm(features[free] - mode.centre, axis=1) / mode.reach
        inside = (depth <= best) & (kinds[free] == mode.kind)
        labels[free[inside]] = number
        best[inside] = depth[inside]


def _grouped(features: Features, rest: Labels) -> list[Labels]:
    """Group some tracks of one kind; return the numbers of the tracks of each group."""
    try:
        from sklearn.cluster import HDBSCAN
    except ImportError:
        raise UsageError("modes need scikit-learn: pip install 'counterpoint[curation]'") from None
    if len(rest) < 2 * FEWEST_MEMBERS:
        return []
    found = HDBSCAN(
        min_cluster_size=FEWEST_MEMBERS,
        min_samples=NEIGHBOURS,
        allow_single_cluster=True,
        copy=True,
    ).fit_predict(features[rest])
    return [rest[found == number] for number in range(int(found.max()) + 1)]


def _formed(members: Labels, features: Features, tracks: Sequence[ModeTrack]) -> _Formed:
    centre = features[members].mean(axis=0)
    away = np.linalg.norm(features[members] - centre, axis=1)
    first = tracks[int(members[0])]
    digest = sha256(first.key.encode()).hexdigest()[:8]
    return _Formed(
        mode_id=f"mode-{digest}",
        name=_name_of([tracks[at].track for at in members.tolist()]),
        kind=first.track.kind,
        centre=centre,
        reach=float(np.quantile(away, REACH)) + 1e-6,
    )


def _name_of(tracks: Sequence[TrackSummary]) -> str:
    """Name a mode by its commonest kind and class and its middle size, distance and speed."""
    kind, _ = Counter(track.kind for track in tracks).most_common(1)[0]
    class_name, _ = Counter(track.class_name for track in tracks).most_common(1)[0]
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
