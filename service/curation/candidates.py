"""Candidates of a selection, their columns, and the choices that are made from them. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Self
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import MAX_INTEGER, MAX_LISTED, Count, Finite, Kept, Said
from schemas.surroundings import CloudStatistics, ScenePlace
from service.curation.descriptors import Descriptors, describe, describing, with_weather
from service.curation.places import name_of_cell
from service.curation.ranking import RankedScene

BALANCED: Final = ("vehicle", "software version", "kind", "place")
"""Groups over which a selection is balanced; a place is a cell of 100 m."""

PLACE: Final = BALANCED.index("place")
"""Number of the group that an unknown value leaves out: logs without places are no one place."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A scene that may be selected.

    Attributes:
        scene: Its row of the ranking.
        vehicle: Vehicle that recorded it; empty unknown.
        software_version: Software that the vehicle ran; empty unknown.
        seq: Number of its event, in the order in which scenes became current.
        cloud: Statistics of its clouds; None where they are not known.
        place: Where it was recorded; None where that is not known.
    """

    scene: RankedScene
    vehicle: str = ""
    software_version: str = ""
    seq: int = 0
    cloud: CloudStatistics | None = None
    place: ScenePlace | None = None

    @property
    def kind(self) -> str:
        """Kind of its strongest listed reason; empty without one."""
        tracks = describing(self.scene)
        return tracks[0].kind if tracks else ""

    @property
    def groups(self) -> tuple[str, str, str, str]:
        """Its value in each of the groups `BALANCED`."""
        return self.vehicle, self.software_version, self.kind, name_of_cell(self.place)


class Choice(BaseModel):
    """One scene of a selection, and why it was chosen."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scene: RankedScene
    gain: Finite = Field(description="What it adds to the objective; its score without one.")
    why: Said = Field(description="Its score and what it adds to the choices before it.")


class Proposal(BaseModel):
    """The choice that a selection would store, in the order in which it was made."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    strategy: Kept
    budget: int = Field(ge=1, le=MAX_INTEGER, description="Number of scenes requested.")
    taken: Count = Field(description="Scenes of earlier selections, which are not chosen again.")
    choices: tuple[Choice, ...] = Field(fail_fast=True, max_length=MAX_LISTED)


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Candidates as columns.

    Attributes:
        quality: (N,) scores, 0 to 1.
        descriptors: (N, D) unit vectors.
        groups: (N, len(BALANCED)) digests of their values in the groups; 0 unknown.
    """

    quality: NDArray[np.float64]
    descriptors: Descriptors
    groups: NDArray[np.int64] = field(repr=False)

    def __len__(self) -> int:
        """Return the number of candidates."""
        return len(self.quality)

    def at(self, chosen: NDArray[np.int64] | slice) -> Self:
        """Return some of the candidates."""
        return type(self)(self.quality[chosen], self.descriptors[chosen], self.groups[chosen])

    def then(self, other: Self) -> Self:
        """Return these candidates and then others."""
        return type(self)(
            np.concatenate([self.quality, other.quality]),
            np.concatenate([self.descriptors, other.descriptors]),
            np.concatenate([self.groups, other.groups]),
        )


def rows_of(candidates: Sequence[Candidate]) -> Rows:
    """Arrange candidates as columns."""
    scenes = [each.scene for each in candidates]
    groups = [[crc32(value.encode()) for value in each.groups] for each in candidates]
    return Rows(
        quality=np.array([scene.score for scene in scenes], np.float64),
        descriptors=with_weather(describe(scenes), [each.cloud for each in candidates]),
        groups=np.array(groups, np.int64).reshape(len(scenes), len(BALANCED)),
    )
