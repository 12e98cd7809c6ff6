"""Scenes of the two sides of a comparison, and which of them are compared. Pure."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.arrays import NS_PER_S
from schemas.contradiction import TrackRecord
from schemas.surroundings import ScenePlace
from service.curation.comparison import Match
from service.curation.places import name_of_cell

SPEEDS_M_PER_S: Final = (3.0, 10.0)
"""Speeds of the car between kinds of road: standing or creeping, a street, a main road."""

DENSITIES: Final = 3
"""Kinds of traffic: thirds of the scenes by the share of points that the streams find moving."""

LOGS_AT_A_PLACE: Final = 4
"""Logs of each side in a cell of 100 m, from which on its scenes are compared by themselves.

With fewer, the spread between logs at the place is not known; their scenes go by kind of road.
"""

MOSTLY_SAME: Final = 0.5
"""Share of the logs of the smaller side that are on both, from which `auto` compares the same."""


@dataclass(frozen=True, slots=True)
class ComparedScene:
    """A scored scene of one side.

    Attributes:
        scene_id: `<log_id>/<lidar>/<start_ns>`.
        log_id: Its recording.
        start_ns: First frame, nanoseconds since the Unix epoch.
        end_ns: Last frame.
        vehicle: Vehicle that recorded it.
        software_version: Software that the vehicle ran.
        seq: Number of its event; 0 for a scene that is no longer current.
        score: Its score.
        speed_m_per_s: Mean speed of the car.
        moving_share: Share of the compared points that the self-supervised stream labels dynamic.
            It does not depend on the software under test.
        tracks: Its strong tracks on which the supervised stream errs, strongest first.
        place: Where it was recorded; None where that is not known.
        labelled_share: Share of its returns that the supervised stream labels.
    """

    scene_id: str
    log_id: str
    start_ns: int
    end_ns: int
    vehicle: str
    software_version: str
    seq: int
    score: float
    speed_m_per_s: float
    moving_share: float
    tracks: tuple[TrackRecord, ...]
    place: ScenePlace | None = None
    labelled_share: float = 1.0

    @property
    def hours(self) -> float:
        """Its duration, hours."""
        return max(0, self.end_ns - self.start_ns) / NS_PER_S / 3600.0


@dataclass(frozen=True, slots=True)
class NamedSide:
    """One side of a comparison.

    Attributes:
        name: Its terms, as a user gave them.
        scenes: Its scored scenes.
    """

    name: str
    scenes: Sequence[ComparedScene]


@dataclass(frozen=True, slots=True, eq=False)
class Matched:
    """Scenes that are compared.

    Attributes:
        a: Scenes of A.
        b: Scenes of B.
        road_a: (len(a),) number of the kind of road of each.
        road_b: (len(b),) the same of B.
        roads: Number of kinds of road; 0 where the same logs are compared.
        places: Names of the places that are a kind of road by themselves; those of scenes are in
            `at_a` and `at_b`.
        places_too_few: Number of places that both sides passed, one of them with too few logs.
        at_a: Place of each scene of A, empty where it goes by kind of road.
        at_b: The same of B.
    """

    a: Sequence[ComparedScene]
    b: Sequence[ComparedScene]
    road_a: NDArray[np.int64]
    road_b: NDArray[np.int64]
    roads: int
    places: Sequence[str] = ()
    places_too_few: int = 0
    at_a: Sequence[str] = ()
    at_b: Sequence[str] = ()


def match_scenes(a: NamedSide, b: NamedSide, match: Match) -> Matched:
    """Return the scenes of the logs, or of the kinds of road, that both sides have.

    A place that enough logs of both sides passed is a kind of road by itself.
    """
    logs_a, logs_b = ({scene.log_id for scene in side.scenes} for side in (a, b))
    common = logs_a & logs_b
    if match == "auto":
        mostly = len(common) >= MOSTLY_SAME * max(1, min(len(logs_a), len(logs_b)))
        match = "logs" if mostly else "roads"
    if match == "logs":
        kept_a, kept_b = (
            [scene for scene in side.scenes if scene.log_id in common] for side in (a, b)
        )
        none = np.zeros(0, np.int64)
        return Matched(kept_a, kept_b, none, none, roads=0)
    return _same_roads(a.scenes, b.scenes)


def _same_roads(a: Sequence[ComparedScene], b: Sequence[ComparedScene]) -> Matched:
    both = [*a, *b]
    shares = np.array([scene.moving_share for scene in both], np.float64)
    edges = np.quantile(shares, np.arange(1, DENSITIES) / DENSITIES)
    speeds = np.array([scene.speed_m_per_s for scene in both], np.float64)
    fast = np.searchsorted(SPEEDS_M_PER_S, speeds, side="right")
    road = fast * DENSITIES + np.searchsorted(edges, shares, side="right")
    kinds = (len(SPEEDS_M_PER_S) + 1) * DENSITIES
    shared, too_few = _shared_cells(a, b)
    cells = {cell: kinds + number for number, cell in enumerate(shared)}
    cell_of = [name_of_cell(scene.place) for scene in both]
    at = [cell if cell in cells else "" for cell in cell_of]
    road = np.array(
        [cells.get(cell, kind) for cell, kind in zip(cell_of, road.tolist(), strict=True)], np.int64
    )
    road_a, road_b = road[: len(a)], road[len(a) :]
    common = np.intersect1d(road_a, road_b)
    in_a, in_b = np.flatnonzero(np.isin(road_a, common)), np.flatnonzero(np.isin(road_b, common))
    return Matched(
        [a[number] for number in in_a.tolist()],
        [b[number] for number in in_b.tolist()],
        np.searchsorted(common, road_a[in_a]),
        np.searchsorted(common, road_b[in_b]),
        roads=len(common),
        places=shared,
        places_too_few=too_few,
        at_a=[at[number] for number in in_a.tolist()],
        at_b=[at[len(a) + number] for number in in_b.tolist()],
    )


def _shared_cells(a: Sequence[ComparedScene], b: Sequence[ComparedScene]) -> tuple[list[str], int]:
    """Return the cells of places that `LOGS_AT_A_PLACE` logs of each side passed, by name.

    The number is that of the cells that both passed, one of them with fewer logs.
    """
    passed: tuple[defaultdict[str, set[str]], ...] = (defaultdict(set), defaultdict(set))
    for logs, scenes in zip(passed, (a, b), strict=True):
        for scene in scenes:
            if scene.place is not None:
                logs[name_of_cell(scene.place)].add(scene.log_id)
    both = passed[0].keys() & passed[1].keys()
    enough = sorted(
        cell for cell in both if min(len(logs[cell]) for logs in passed) >= LOGS_AT_A_PLACE
    )
    return enough, len(both) - len(enough)
