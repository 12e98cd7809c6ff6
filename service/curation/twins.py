"""Twins: scenes that show the same thing as a better scene which is no twin itself. Pure.

A scene is a twin where its strongest reason, and every reason at least half as strong, is of a
thing that one better neighbour shows too. A thing is the same if its kind of contradiction and its
class are, and its place where one scene ends is near its place where the other begins.

Another drive past the same place is a twin too, where logs record global places. All its weighty
reasons are then of things that stand, and that one better scene shows at the same place on Earth
while its car drives in the same direction.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.contradiction import Place, TrackRecord
from schemas.surroundings import ScenePlace
from service.curation.places import Spot, apart_m, spot_in, turn_between_rad
from service.curation.ranking import Neighbour, are_neighbours, is_reason

NEAR_M: Final = 2.0
"""Distance of the same place beyond half of the thing's length, metres: the centre of what a lidar
sees of a thing wanders so far between views.
"""

NEAR_ON_EARTH_M: Final = 6.0
"""The same for a place on Earth, metres: receivers of two days differ by twice their error, 3 m."""

STANDING_M_PER_S: Final = 1.0
"""Speed up to which a thing stands; one that drives is another one on another day."""

SAME_DIRECTION_RAD: Final = math.pi / 4
"""Angle between two drives past a place up to which they show the same side of things."""

SAME_DRIVE_NS: Final = 120 * NS_PER_S
"""Time between scenes of a log from which on they may be twins in place, nanoseconds: a car comes
back to a place no sooner. Neighbours in time are compared by their own, narrower rule.
"""

_CELL_M: Final = 20.0
"""Edge of the cells in which things are looked up, metres: no things further apart are the same."""

WEIGHTY_SHARE: Final = 0.5
"""Strength, as a share of the strongest reason's, from which a reason must be shown elsewhere."""


_Stands = tuple[str, str, tuple[str, int, int]]
"""Kind, class and cell of a thing that stands."""


@dataclass(frozen=True, slots=True)
class ShownScene:
    """Fields of a scene that decide whether it is a twin.

    Attributes:
        at: Its id and its time.
        odom: Identity of its odom space; places of scenes with the same one are comparable.
        driven_m: Path of the sensor over the scene, metres.
        tracks: Its tracks of at least `MIN_REPORTED_STRENGTH`, strongest first.
        place: Where it was recorded; None where that is not known.
    """

    at: Neighbour
    odom: object
    driven_m: float
    tracks: tuple[TrackRecord, ...]
    place: ScenePlace | None = None

    @property
    def reasons(self) -> list[TrackRecord]:
        """Tracks that are a reason to review the scene, strongest first."""
        return [
            track
            for track in self.tracks
            if is_reason(track.strength, track.attribution.wrong if track.attribution else None)
        ]

    @property
    def weighty(self) -> list[TrackRecord]:
        """Its reasons that a scene has to show of which it is a twin."""
        reasons = self.reasons
        return [each for each in reasons if each.strength >= WEIGHTY_SHARE * reasons[0].strength]


class Twins:
    """Finds twins among scenes that come in the order of the ranking."""

    def __init__(self) -> None:
        """Begin with no scene."""
        self._kept: dict[str, ShownScene] = {}
        self._standing: dict[_Stands, list[str]] = {}

    def twin_of(self, scene: ShownScene, neighbours: Iterable[Neighbour | None]) -> str | None:
        """Return the id of a better scene that shows the same, the best where there are two.

        Neighbours in time come before other drives past the same place.

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
        for scene_id, kept in self._better(self._at_the_place_of(scene)):
            if shows_all_there(kept, scene):
                return scene_id
        self._keep(scene)
        return None

    def _keep(self, scene: ShownScene) -> None:
        self._kept[scene.at.scene_id] = scene
        for track in scene.tracks:
            spot = standing_spot(track, scene)
            if spot is not None:
                key = (track.kind, track.class_name, spot.cell(_CELL_M))
                self._standing.setdefault(key, []).append(scene.at.scene_id)

    def _at_the_place_of(self, scene: ShownScene) -> set[str]:
        """Return the better scenes with a like thing near that of the strongest reason."""
        track = scene.weighty[0]
        spot = standing_spot(track, scene)
        cells = () if spot is None else spot.cells_around(_CELL_M)
        keys = ((track.kind, track.class_name, cell) for cell in cells)
        return {scene_id for key in keys for scene_id in self._standing.get(key, ())}

    def _better(self, near: set[str]) -> Iterable[tuple[str, ShownScene]]:
        """Return the neighbours that came before and are no twins, by their strongest track."""
        kept = [(each, self._kept[each]) for each in near if each in self._kept]
        return sorted(kept, key=lambda pair: (-pair[1].tracks[0].strength, pair[0]))


def shows_all(better: ShownScene, scene: ShownScene) -> bool:
    """Return true if a scene shows every weighty reason of another one, which has a reason."""
    return all(
        any(same_thing(one, better, each, scene) for one in better.tracks) for each in scene.weighty
    )


def shows_all_there(better: ShownScene, scene: ShownScene) -> bool:
    """Return true if a scene of another drive shows every weighty reason at the same place."""
    if not is_in_place(scene.at.scene_id, better.at.scene_id):
        return False
    if not _drive_alike(better.place, scene.place):
        return False
    return all(
        any(stands_there(one, better, each, scene) for one in better.tracks)
        for each in scene.weighty
    )


def is_in_place(scene_id: str, twin_of: str) -> bool:
    """Return true if two scenes are of different drives, so that they are twins by their place."""
    (log_id, start_ns), (other_id, other_ns) = map(_drive_of, (scene_id, twin_of))
    return log_id != other_id or abs(start_ns - other_ns) >= SAME_DRIVE_NS


def stands_there(
    one: TrackRecord, of: ShownScene, other: TrackRecord, in_scene: ShownScene
) -> bool:
    """Return true if tracks of two drives are of things alike that stand at the same place."""
    if (one.kind, one.class_name) != (other.kind, other.class_name):
        return False
    here, there = standing_spot(one, of), standing_spot(other, in_scene)
    if here is None or there is None:
        return False
    near_m = NEAR_ON_EARTH_M + max(one.strongest.size_m[0], other.strongest.size_m[0]) / 2
    return apart_m(here, there) <= min(near_m, _CELL_M)


def standing_spot(track: TrackRecord, scene: ShownScene) -> Spot | None:
    """Return the place on Earth of a thing that stands; None if it drives or is not placed."""
    if scene.place is None or track.first_odom_m is None or track.last_odom_m is None:
        return None
    drifted_m = _apart_m(track.first_odom_m, track.last_odom_m)
    if track.speed_m_per_s > STANDING_M_PER_S or drifted_m > NEAR_M:
        return None
    return spot_in(scene.place, track.first_odom_m[:2])


def _drive_alike(one: ScenePlace | None, other: ScenePlace | None) -> bool:
    if one is None or other is None or one.heading_rad is None or other.heading_rad is None:
        return False
    return turn_between_rad(one.heading_rad, other.heading_rad) <= SAME_DIRECTION_RAD


def _drive_of(scene_id: str) -> tuple[str, int]:
    """Return log and start of a scene by its id, `<log_id>/<lidar>/<start_ns>`."""
    log_id, _, begins = scene_id.rpartition("/")
    return log_id.rpartition("/")[0] or scene_id, int(begins) if begins.isdecimal() else 0


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
