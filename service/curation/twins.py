"""Twins: neighbours that show the same thing as a better scene which is no twin itself. Pure.

A scene is a twin where its strongest reason, and every reason at least half as strong, is of a
thing that one better neighbour shows too. A thing is the same if its kind of contradiction and its
class are, and its place where one scene ends is near its place where the other begins.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from schemas.contradiction import Place, TrackRecord
from service.curation.ranking import Neighbour, are_neighbours, is_reason

NEAR_M: Final = 2.0
"""Distance of the same place beyond half of the thing's length, metres: the centre of what a lidar
sees of a thing wanders so far between views.
"""

WEIGHTY_SHARE: Final = 0.5
"""Strength, as a share of the strongest reason's, from which a reason must be shown elsewhere."""


@dataclass(frozen=True, slots=True)
class ShownScene:
    """Fields of a scene that decide whether it is a twin.

    Attributes:
        at: Its id and its time.
        odom: Identity of its odom space; places of scenes with the same one are comparable.
        driven_m: Path of the sensor over the scene, metres.
        tracks: Its tracks of at least `MIN_REPORTED_STRENGTH`, strongest first.
    """

    at: Neighbour
    odom: object
    driven_m: float
    tracks: tuple[TrackRecord, ...]

    @property
    def reasons(self) -> list[TrackRecord]:
        """Tracks that are a reason to review the scene, strongest first."""
        return [
            track
            for track in self.tracks
            if is_reason(track.strength, track.attribution.wrong if track.attribution else None)
        ]


class Twins:
    """Finds twins among scenes that come in the order of the ranking."""

    def __init__(self) -> None:
        """Begin with no scene."""
        self._kept: dict[str, ShownScene] = {}

    def twin_of(self, scene: ShownScene, neighbours: Iterable[Neighbour | None]) -> str | None:
        """Return the id of a better neighbour that shows the same, the best where there are two.

        Args:
            scene: The next scene of the ranking.
            neighbours: Scenes of the same log and lidar right before and after it.
        """
        if not scene.reasons:
            return None
        near = {each.scene_id for each in neighbours if each and are_neighbours(each, scene.at)}
        for scene_id, kept in self._better(near):
            if shows_all(kept, scene):
                return scene_id
        self._kept[scene.at.scene_id] = scene
        return None

    def _better(self, near: set[str]) -> Iterable[tuple[str, ShownScene]]:
        """Return the neighbours that came before and are no twins, by their strongest track."""
        kept = [(each, self._kept[each]) for each in near if each in self._kept]
        return sorted(kept, key=lambda pair: (-pair[1].tracks[0].strength, pair[0]))


def shows_all(better: ShownScene, scene: ShownScene) -> bool:
    """Return true if a scene shows every weighty reason of another one, which has a reason."""
    reasons = scene.reasons
    weighty = [each for each in reasons if each.strength >= WEIGHTY_SHARE * reasons[0].strength]
    return all(
        any(same_thing(one, better, each, scene) for one in better.tracks) for each in weighty
    )


def same_thing(one: TrackRecord, of: ShownScene, other: TrackRecord, in_scene: ShownScene) -> bool:
    """Return true if a track of one scene and a track of its neighbour are the same thing."""
    if (one.kind, one.class_name) != (other.kind, other.class_name):
        return False
    if of.at.start_ns > in_scene.at.start_ns:
        one, other = other, one
    near_m = NEAR_M + max(one.strongest.size_m[0], other.strongest.size_m[0]) / 2
    speed_m_per_s = max(one.speed_m_per_s, other.speed_m_per_s)
    if of.odom == in_scene.odom and one.last_odom_m and other.first_odom_m:
        gap_s = max(0, other.first_ns - one.last_ns) / 1e9
        return _apart_m(one.last_odom_m, other.first_odom_m) <= near_m + speed_m_per_s * gap_s
    # Without a common space the sensor's own way is added to what the place may be off.
    gap_s = abs(other.strongest.stamp_ns - one.strongest.stamp_ns) / 1e9
    way_m = speed_m_per_s * gap_s + of.driven_m + in_scene.driven_m
    return _apart_m(one.strongest.centre_m, other.strongest.centre_m) <= near_m + way_m


def _apart_m(one: Place, other: Place) -> float:
    return math.dist(one[:2], other[:2])
