"""When else a thing was seen to move: by the one of the two onlookers whose track it is not.

The self-supervised stream proves a motion from the past, the witness from the future as well: of a
thing that comes into sight the witness speaks first, and where the stream falls silent it speaks
alone. Both contradict a supervised stream that says it stands, and what lasts is the contradiction.
What is seen in a thing's stead may be a scrap of it, or of something else: it counts by the share
of the thing's points that it has.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import Instance, Scene
from workers.contradiction.settings import DEFAULT_TRACKS, TrackSettings
from workers.contradiction.track_motion import FEWEST, velocity_of
from workers.contradiction.tracks import Track, frame_period_s, longest_gap_s


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """Where one of the onlookers sees motion.

    Attributes:
        centre_m: (2,) of its box, odom space.
        points: How many.
    """

    centre_m: NDArray[np.float64]
    points: int


@dataclass(frozen=True, slots=True, eq=False)
class Company:
    """What the tracks of a scene share when asked who else saw their thing: worked out once.

    Attributes:
        stamps_s: (F,) times of the frames since the scene began.
        longest_gap_s: How long a thing may go unseen.
        others: By kind of contradiction and frame: what the other onlooker sees.
    """

    stamps_s: NDArray[np.float64]
    longest_gap_s: float
    others: Mapping[str, Mapping[int, Sequence[Sighting]]]


def company_of(
    scene: Scene,
    tracks: Sequence[Track],
    instances: Sequence[Instance],
    *,
    settings: TrackSettings = DEFAULT_TRACKS,
) -> Company:
    """Say for each kind in which one onlooker sees motion where the other one sees it.

    Args:
        scene: Where it was found.
        tracks: All of it; every instance is in exactly one.
        instances: As the tracks count them.
        settings: Gates.
    """
    onlookers = [kind for kind in scene.task.kinds if kind.measured or kind.of_witness]
    others: dict[str, dict[int, list[Sighting]]] = {kind.name: {} for kind in onlookers}
    for track in tracks:
        for kind in onlookers if track.kind in onlookers else ():
            if kind == track.kind:
                continue
            for member, centre_m in zip(track.members, track.centres_m, strict=True):
                instance = instances[member]
                seen = others[kind.name].setdefault(instance.frame_index, [])
                seen.append(Sighting(centre_m[:2], len(instance.point_index)))
    return Company(
        stamps_s=np.array([(f.stamp_ns - scene.start_ns) / NS_PER_S for f in scene.frames]),
        longest_gap_s=longest_gap_s(frame_period_s(scene), settings),
        others=others,
    )


def frames_seen(
    track: Track,
    members: Sequence[Instance],
    company: Company,
    *,
    settings: TrackSettings = DEFAULT_TRACKS,
) -> Mapping[int, float]:
    """Find the frames in which a thing was seen, by its own track or in its stead.

    From either end of the track, and in its gaps, it is looked for where it should be. Two frames
    do not say where that is.

    Args:
        track: Its track.
        members: The instances of the track.
        company: Who else saw something.
        settings: Gates.

    Returns:
        What each frame counts, by its index, rising: 1 where the track itself is seen, else the
        share of its usual points that was seen, at most 1.
    """
    own = [member.frame_index for member in members]
    counts = dict.fromkeys(own, 1.0)
    stamps_s = company.stamps_s
    theirs = company.others.get(track.kind.name, {})
    if len(own) < FEWEST or not theirs:
        return counts
    velocity = velocity_of(track.centres_m, stamps_s[own])
    longest_m = max(float(member.size_m[0]) for member in members)
    gate_m = min(settings.gate_m + settings.gate_per_length * longest_m, settings.max_gate_m)
    usual = float(np.median([len(member.point_index) for member in members]))
    known = {at: centre[:2] for at, centre in zip(own, track.centres_m, strict=True)}
    for steps in (range(own[0] - 1, -1, -1), range(own[0] + 1, len(stamps_s))):
        at = own[0]
        for frame in steps:
            if frame not in known and abs(stamps_s[frame] - stamps_s[at]) <= company.longest_gap_s:
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
