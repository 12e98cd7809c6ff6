"""Messages of a comparison of two versions: its two sides, its groups, and the scenes that show it.

A comparison is a release gate: does version B contradict more often than version A, and where?
"""

from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import MAX_LISTED, Count, Finite, Kept, Name, Said, StampNs
from schemas.score import Share

_STRICT: Final = ConfigDict(frozen=True, extra="forbid")

EXAMPLES: Final = 5
"""Scenes that show a group, of each side at most."""

MAX_TOLERANCE: Final = 100.0

MOST_PLACES: Final = 50
"""Compared places that a comparison lists."""

Match = Literal["auto", "logs", "roads"]
"""Design of a comparison: `logs` compares the very same logs, `roads` scenes of the same kind of
road, and `auto` takes `logs` where most logs are on both sides.
"""

GroupBy = Literal["all", "kind", "class", "mode"]
"""Property that the tracks of a group have in common."""

Outcome = Literal["regressed", "improved", "same"]
"""Result of a group: a difference that is significant after the correction, or none."""

SideOf = Literal["a", "b"]


class ComparedSide(BaseModel):
    """One of the two versions: the scenes that are compared.

    Without a pipeline version these are current scenes. With one they are its scenes of the
    recordings in the bucket, also where a newer pipeline version has replaced them.
    """

    model_config = _STRICT

    software_version: Name | None = Field(default=None, description="Null: any.")
    pipeline_version: Name | None = Field(
        default=None, description="Name or its first characters; null: current scenes."
    )
    vehicle: Name | None = Field(default=None, description="Null: any.")
    since_ns: StampNs = Field(default=0, description="Recorded at or after, ns since the epoch.")
    until_ns: StampNs | None = Field(default=None, description="Recorded before; null: no limit.")


class ComparisonTerms(BaseModel):
    """Terms of a comparison."""

    model_config = _STRICT

    match: Match = "auto"
    tolerance: Annotated[float, Field(ge=0, le=MAX_TOLERANCE)] = Field(
        default=0.0,
        description="Share by which the rate of B may exceed that of A: 0.1 allows 10 % more.",
    )


class CompareRequest(BaseModel):
    """Request to compare two versions."""

    model_config = _STRICT

    a: ComparedSide = Field(description="The version before.")
    b: ComparedSide = Field(description="The version that is to be released.")
    terms: ComparisonTerms = ComparisonTerms()


class Rate(BaseModel):
    """Rate of a group on one side."""

    model_config = _STRICT

    tracks: Count = Field(description="Strong tracks on which the supervised stream errs.")
    scenes: Count = Field(description="Scenes with one of them.")
    per_hour: Finite = Field(description="Tracks per hour driven, over the weights of the roads.")
    low: Finite = Field(description="Lower bound of its 95 % interval, by log.")
    high: Finite = Field(description="Upper bound of its 95 % interval, by log.")
    per_scene: Finite = Field(description="Tracks per scene.")


class ComparedExample(BaseModel):
    """A track that shows a difference."""

    model_config = _STRICT

    side: SideOf
    scene_id: Kept
    track_id: Count = Field(description="As in the record of the scene.")
    strength: Share
    headline: Said = Field(description="Class, size, distance and speed of the track.")


class ComparedGroup(BaseModel):
    """One comparison: tracks of a kind, a class or a mode on both sides."""

    model_config = _STRICT

    by: GroupBy
    group: Said = Field(description="Kind, class, or id of the mode; empty: all, or no class.")
    name: Said = Field(default="", description="Name of the mode; else empty.")
    a: Rate
    b: Rate
    difference: Finite = Field(description="Rate of B less rate of A, per hour driven.")
    low: Finite = Field(description="Lower bound of its 95 % interval, by log.")
    high: Finite = Field(description="Upper bound of its 95 % interval, by log.")
    corrected_low: Finite = Field(description="The same, corrected by Holm for all comparisons.")
    corrected_high: Finite
    p: Share = Field(description="Two-sided, by exchange of whole logs between the versions.")
    corrected_p: Share = Field(description="Corrected by Holm for the number of comparisons.")
    outcome: Outcome
    gone: Count | None = Field(
        default=None, description="Of the same logs: tracks of A that B does not show; else null."
    )
    new: Count | None = Field(
        default=None, description="Of the same logs: tracks of B that A does not show; else null."
    )
    examples: tuple[ComparedExample, ...] = Field(
        default=(),
        max_length=2 * EXAMPLES,
        description="Strongest tracks: of B where it regressed, of A where it improved.",
    )


class SideSummary(BaseModel):
    """Extent of one side."""

    model_config = _STRICT

    name: Said = Field(description="Filters of the side, in words.")
    logs: Count
    scenes: Count = Field(description="Scored scenes that are compared.")
    hours: Finite = Field(description="Hours driven in them.")
    left_out: Count = Field(description="Scored scenes of a road, or a log, that B or A lacks.")
    labelled_share: Share = Field(
        default=1.0,
        exclude_if=lambda value: value == 1.0,
        description="Share of the returns that the supervised stream labels; absent: 1.",
    )


class PlaceExtent(BaseModel):
    """Extent of one side at a place."""

    model_config = _STRICT

    logs: Count
    scenes: Count
    tracks: Count = Field(description="Strong tracks on which the supervised stream errs.")


class ComparedPlace(BaseModel):
    """A place whose scenes are compared with each other only."""

    model_config = _STRICT

    place: Said = Field(
        description="South-west corner of a square of 100 m, in degrees of latitude and longitude; "
        "or the name of a frame, and x and y in metres."
    )
    a: PlaceExtent
    b: PlaceExtent


class Comparison(BaseModel):
    """Result of a comparison: every group that was tested, the worst first."""

    model_config = _STRICT

    a: SideSummary
    b: SideSummary
    matched: Literal["logs", "roads"] = Field(description="Design that was used.")
    roads: Count = Field(description="Kinds of road that both sides drove; 0: the same logs.")
    places: Count = Field(
        default=0,
        exclude_if=lambda value: value == 0,
        description="Those of them that are one place, of 100 m; absent without one.",
    )
    places_too_few: Count = Field(
        default=0,
        exclude_if=lambda value: value == 0,
        description="Places that both sides passed, one with fewer than 4 logs: their scenes go "
        "by kind of road. Absent without one.",
    )
    at_places: tuple[ComparedPlace, ...] = Field(
        default=(),
        max_length=MOST_PLACES,
        exclude_if=lambda value: value == (),
        description="The places, the greatest rise of tracks first; absent without one.",
    )
    tolerance: Finite
    comparisons: Count = Field(description="Groups that were tested, for which Holm corrects.")
    too_few: Count = Field(description="Groups with too few tracks or logs, which are not tested.")
    modes: bool = Field(description="False: modes were not compared, scikit-learn is missing.")
    regressed: Count = Field(description="Groups that regressed beyond the tolerance.")
    improved: Count
    groups: tuple[ComparedGroup, ...] = Field(fail_fast=True, max_length=MAX_LISTED)
    answers_less: bool = Field(
        default=False,
        exclude_if=lambda value: not value,
        description="B labels fewer returns than A, by more than 5 % of all: what is not labelled "
        "cannot contradict. Absent: no.",
    )

    @property
    def passed(self) -> bool:
        """True if no group regressed, and B answers as much as A."""
        return not self.regressed and not self.answers_less
