"""Tracks of a comparison: their groups, and those that the other version does not show. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from schemas.arrays import NS_PER_S
from schemas.contradiction import TrackRecord
from schemas.events import RankedScene, TrackSummary
from service.curation.candidates import Candidate
from service.curation.compared_scenes import ComparedScene
from service.curation.comparison import GroupBy, SideOf
from service.curation.modes import FIRST_GROUPED, ModeTrack, modes_of
from service.errors import UsageError

NEAR_M: Final = 3.0
"""Distance up to which two tracks of one log are of the same object, metres."""

SOON_NS: Final = NS_PER_S // 2
"""Time between the strongest moments of both up to which their places are compared."""


@dataclass(frozen=True, slots=True, order=True)
class Group:
    """Tracks with one property in common.

    Attributes:
        by: Property.
        group: Its value.
        name: Name of a mode; else empty.
    """

    by: GroupBy
    group: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class ComparedTrack:
    """A track of a side, in its scene, with the groups that it belongs to."""

    side: SideOf
    scene: ComparedScene
    track: TrackRecord
    groups: tuple[Group, ...]


def grouped_tracks(
    a: Sequence[ComparedScene], b: Sequence[ComparedScene]
) -> tuple[list[ComparedTrack], bool]:
    """Return the tracks of both sides with their groups, and whether modes were formed.

    Modes are formed of the tracks of both sides together. Without scikit-learn there are none.
    """
    sides: tuple[tuple[SideOf, Sequence[ComparedScene]], ...] = (("a", a), ("b", b))
    found = [
        (side, scene, track) for side, scenes in sides for scene in scenes for track in scene.tracks
    ]
    try:
        modes, knows = _modes(found), True
    except UsageError:  # scikit-learn is an extra; kinds and classes are compared without it
        modes, knows = {}, False
    return [
        ComparedTrack(side, scene, track, _groups(track, modes.get(number)))
        for number, (side, scene, track) in enumerate(found)
    ], knows


def _groups(track: TrackRecord, mode: Group | None) -> tuple[Group, ...]:
    groups = (Group("all", ""), Group("kind", track.kind), Group("class", track.class_name))
    return groups if mode is None else (*groups, mode)


def _modes(found: Sequence[tuple[SideOf, ComparedScene, TrackRecord]]) -> dict[int, Group]:
    """Return the mode of each track that is of one, by its number."""
    if len(found) < FIRST_GROUPED:
        return {}
    tracks = [_mode_track(scene, track, number) for number, (_, scene, track) in enumerate(found)]
    return {
        member.candidate.seq: Group("mode", mode.mode_id, mode.name)
        for mode in modes_of(tracks)
        for member in mode.members
    }


def _mode_track(scene: ComparedScene, track: TrackRecord, number: int) -> ModeTrack:
    row = RankedScene(
        rank=1,
        scene_id=scene.scene_id,
        log_id=scene.log_id,
        start_ns=scene.start_ns,
        end_ns=scene.end_ns,
        score=scene.score,
        sha256="",
    )
    candidate = Candidate(row, scene.vehicle, scene.software_version, seq=number)
    return ModeTrack(candidate, TrackSummary.of(track))


def unmatched(tracks: Sequence[ComparedTrack]) -> list[bool]:
    """Return for each track whether the other side does not show it in the same log.

    Each track is matched once, strongest first, to one of the other side that is near it in time
    and place: the same object contradicts in both versions.
    """
    of_log: dict[str, list[int]] = {}
    for number, each in enumerate(tracks):
        of_log.setdefault(each.scene.log_id, []).append(number)
    alone = [True] * len(tracks)
    for numbers in of_log.values():
        ours = [at for at in numbers if tracks[at].side == "a"]
        theirs = [at for at in numbers if tracks[at].side == "b"]
        for at in sorted(ours, key=lambda at: -tracks[at].track.strength):
            near = [
                other
                for other in theirs
                if alone[other] and _is_same(tracks[at].track, tracks[other].track)
            ]
            if near:
                best = min(near, key=lambda other: _apart_m(tracks[at], tracks[other]))
                alone[at] = alone[best] = False
    return alone


def _is_same(one: TrackRecord, other: TrackRecord) -> bool:
    if one.first_ns > other.last_ns or other.first_ns > one.last_ns:
        return False
    away_ns = abs(one.strongest.stamp_ns - other.strongest.stamp_ns)
    if away_ns > SOON_NS and (near := _near_in_odom(one, other)) is not None:
        return near
    slack_m = NEAR_M + max(one.speed_m_per_s, other.speed_m_per_s) * away_ns / NS_PER_S
    return _distance_m(one, other) <= slack_m


def _near_in_odom(one: TrackRecord, other: TrackRecord) -> bool | None:
    """Compare the paths at the middle of the common time; None where one has no path."""
    middle_ns = (max(one.first_ns, other.first_ns) + min(one.last_ns, other.last_ns)) / 2
    places = [_place_at(track, middle_ns) for track in (one, other)]
    if places[0] is None or places[1] is None:
        return None
    return bool(np.linalg.norm(places[0] - places[1]) <= NEAR_M)


def _place_at(
    track: TrackRecord, at_ns: float
) -> np.ndarray[tuple[int], np.dtype[np.float64]] | None:
    if track.first_odom_m is None or track.last_odom_m is None:
        return None
    first, last = np.array(track.first_odom_m), np.array(track.last_odom_m)
    share = (at_ns - track.first_ns) / max(1, track.last_ns - track.first_ns)
    place: np.ndarray[tuple[int], np.dtype[np.float64]] = first + share * (last - first)
    return place


def _distance_m(one: TrackRecord, other: TrackRecord) -> float:
    away = np.subtract(one.strongest.centre_m, other.strongest.centre_m)
    return float(np.hypot(away[0], away[1]))


def _apart_m(one: ComparedTrack, other: ComparedTrack) -> float:
    return _distance_m(one.track, other.track)
