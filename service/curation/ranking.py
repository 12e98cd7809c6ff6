"""Ranked scenes: their reasons for a review, and their neighbours in time. Pure."""

from dataclasses import dataclass
from typing import Final

from schemas.arrays import NS_PER_S
from schemas.attribution import Wrong
from schemas.events import RankedScene as RankedScene
from schemas.score import MIN_REPORTED_STRENGTH

TWIN_GAP_NS: Final = NS_PER_S
"""Largest gap between neighbours, nanoseconds; no street changes within a second. The gap is one
frame period as a rule, or a short gap in the recording.
"""

ERRING: Final = frozenset({Wrong.SUPERVISED, Wrong.BOTH})
"""Attributions by which the supervised stream errs, which a review looks for."""


def is_reason(strength: float, wrong: Wrong | None) -> bool:
    """Return true for a strong track on which the supervised stream errs.

    A track without an attribution, of another task or of an earlier service, counts by its
    strength.
    """
    return strength >= MIN_REPORTED_STRENGTH and (wrong is None or wrong in ERRING)


def has_reason(scene: RankedScene) -> bool:
    """Return true if one of the listed tracks is a reason to review a scene."""
    return any(is_reason(track.strength, track.wrong) for track in scene.tracks)


@dataclass(frozen=True, slots=True)
class Neighbour:
    """Id and time of a scene, for its neighbours."""

    scene_id: str
    start_ns: int
    end_ns: int


def are_neighbours(one: Neighbour, other: Neighbour) -> bool:
    """Return true if less than `TWIN_GAP_NS` lies between two scenes of one log and lidar."""
    gap_ns = max(one.start_ns, other.start_ns) - min(one.end_ns, other.end_ns)
    return gap_ns < TWIN_GAP_NS
