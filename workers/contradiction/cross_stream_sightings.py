"""Sightings of an object by the other motion source, which extend the duration of its track.

The self-supervised stream measures motion from the past, the witness from the future too. The
witness therefore labels an emerging object first, and alone where the stream has no label. Both
contradict a supervised stream that labels the object static, and persistence is that of the
contradiction. A sighting may be a part of the object, or another object: it counts by its share of
the track's points.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import Instance, Scene
from workers.contradiction.settings import DEFAULT_TRACKS, TrackSettings
from workers.contradiction.track_features import DescribedTrack
from workers.contradiction.track_motion import FEWEST, velocity_of
from workers.contradiction.tracks import Track, frame_period_s, longest_gap_s


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A place that one motion source labels dynamic.

    Attributes:
        centre_m: (2,) of its box, odom space.
        points: Its points.
    """

    centre_m: NDArray[np.float64]
    points: int


@dataclass(frozen=True, slots=True, eq=False)
class CrossStreamSightings:
    """Sightings of a scene, by the kind of the tracks that they may extend.

    Attributes:
        stamps_s: (F,) times of the frames since the scene began.
        longest_gap_s: Longest time that an object may go unobserved, seconds.
        others: Sightings of the other motion source, by kind of contradiction and frame index.
    """

    stamps_s: NDArray[np.float64]
    longest_gap_s: float
    others: Mapping[str, Mapping[int, Sequence[Sighting]]]


def sightings_of(
    scene: Scene,
    described: Sequence[DescribedTrack],
    *,
    settings: TrackSettings = DEFAULT_TRACKS,
) -> CrossStreamSightings:
    """Collect, for each kind with one motion source, where the other motion source labels dynamic.

    Args:
        scene: The scene.
        described: All of its tracks; every instance is in exactly one.
        settings: Gates.
    """
    sources = [kind for kind in scene.task.kinds if kind.measured or kind.of_witness]
    others: dict[str, dict[int, list[Sighting]]] = {kind.name: {} for kind in sources}
    for each in described:
        for kind in sources if each.track.kind in sources else ():
            if kind == each.track.kind:
                continue
            for member, centre_m in zip(each.members, each.track.centres_m, strict=True):
                seen = others[kind.name].setdefault(member.frame_index, [])
                seen.append(Sighting(centre_m[:2], len(member.point_index)))
    return CrossStreamSightings(
        stamps_s=np.array([(f.stamp_ns - scene.start_ns) / NS_PER_S for f in scene.frames]),
        longest_gap_s=longest_gap_s(frame_period_s(scene), settings),
        others=others,
    )


def frames_seen(
    track: Track,
    members: Sequence[Instance],
    sightings: CrossStreamSightings,
    *,
    settings: TrackSettings = DEFAULT_TRACKS,
) -> Mapping[int, float]:
    """Find the frames in which either motion source observed an object.

    The search extends from both ends of the track and into its gaps, at the predicted place. A
    track of two frames is not extended: its velocity is too uncertain.

    Args:
        track: Its track.
        members: The instances of the track.
        sightings: Sightings of the scene.
        settings: Gates.

    Returns:
        Weight of each frame, by ascending index: 1 where the track itself has an instance, else the
        points of the sighting as a share of the track's median, at most 1.
    """
    own = [member.frame_index for member in members]
    counts = dict.fromkeys(own, 1.0)
    stamps_s = sightings.stamps_s
    theirs = sightings.others.get(track.kind.name, {})
    if len(own) < FEWEST or not theirs:
        return counts
    velocity = velocity_of(track.centres_m, stamps_s[own])
    longest_m = max(float(member.size_m[0]) for member in members)
    gate_m = min(settings.gate_m + settings.gate_per_length * longest_m, settings.max_gate_m)
    usual = float(np.median([len(member.point_index) for member in members]))
    known = {at: centre[:2] for at, centre in zip(own, track.centres_m, strict=True)}
    gap_s = sightings.longest_gap_s
    for steps in (range(own[0] - 1, -1, -1), range(own[0] + 1, len(stamps_s))):
        at = own[0]
        for frame in steps:
            if frame not in known and abs(stamps_s[frame] - stamps_s[at]) <= gap_s:
                due = known[at] + velocity * (stamps_s[frame] - stamps_s[at])
                found = _nearest(due, theirs.get(frame, ()))
                if found is not None and _away_m(found, due) <= gate_m:
                    known[frame] = found.centre_m
                    counts[frame] = min(1.0, found.points / usual)
            at = frame if frame in known else at
    return dict(sorted(counts.items()))


def _nearest(due_m: NDArray[np.float64], sightings: Sequence[Sighting]) -> Sighting | None:
    return min(sightings, key=lambda each: _away_m(each, due_m), default=None)


def _away_m(sighting: Sighting, due_m: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(sighting.centre_m - due_m))
