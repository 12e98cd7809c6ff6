"""Messages published in addition to records: event numbers, and the scenes of a selection.

A record must not contain its event number. Records of two runs compare byte for byte, whatever the
order in which they were committed.
"""

from typing import Final, Self

from pydantic import BaseModel, ConfigDict, Field

from schemas.attribution import Chance, Wrong
from schemas.bounds import MAX_LISTED, Count, Finite, Kept, Said, StampNs
from schemas.contradiction import KindName, Place, TrackRecord
from schemas.surroundings import ScenePlace
from schemas.verdict import VerdictSummary

MAX_LISTED_TRACKS: Final = 5
"""Tracks of a row of the ranking at most, as many as a record gives reasons about tracks."""


class SceneNumber(BaseModel):
    """Attachment of every put and delete of a scene, live or from the history."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    seq: Count = Field(description="Rises by one per event over the whole ledger.")


class TrackSummary(BaseModel):
    """A strong track of a scene, in a row of the ranking; the record has all about it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    track_id: Count = Field(description="As in the record, and one less than on pictures.")
    kind: KindName
    class_name: Said = Field(default="", description="Commonest semantic class; may be empty.")
    strength: float = Field(ge=0, le=1, description="What it adds to the score of the scene.")
    wrong: Wrong | None = Field(
        default=None, description="Most probable attribution; null where none was made."
    )
    chance: Chance | None = Field(default=None, description="Its probability.")
    first_ns: StampNs = Field(description="First frame it was seen in.")
    last_ns: StampNs = Field(description="Last frame it was seen in.")
    speed_m_per_s: Finite = Field(ge=0, description="Median speed over the ground; 0 unmeasured.")
    stamp_ns: StampNs = Field(description="Frame of its strongest instance.")
    centre_m: Place = Field(description="Centre of that instance, sensor space, metres.")
    size_m: Place = Field(description="Length, width and height of that instance, metres.")
    range_m: Finite = Field(ge=0, description="Its horizontal distance from the sensor, metres.")

    @classmethod
    def of(cls, track: TrackRecord) -> Self:
        """Summarise the record of a track."""
        attribution, strongest = track.attribution, track.strongest
        return cls(
            track_id=track.track_id,
            kind=track.kind,
            class_name=track.class_name,
            strength=track.strength,
            wrong=attribution.wrong if attribution else None,
            chance=attribution.chance if attribution else None,
            first_ns=track.first_ns,
            last_ns=track.last_ns,
            speed_m_per_s=track.speed_m_per_s,
            stamp_ns=strongest.stamp_ns,
            centre_m=strongest.centre_m,
            size_m=strongest.size_m,
            range_m=strongest.range_m,
        )


class RankedScene(BaseModel):
    """One row of the ranking or of a selection, as `counterpoint top --json` prints it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rank: int = Field(ge=1, le=MAX_LISTED, description="Place in the ranking, 1 first.")
    scene_id: Kept = Field(description="`<log_id>/<lidar>/<start_ns>`.")
    log_id: Kept = Field(description="Bucket-relative key of the recording.")
    start_ns: StampNs = Field(description="First frame, nanoseconds since the Unix epoch.")
    end_ns: StampNs = Field(description="Last frame, nanoseconds since the Unix epoch.")
    score: float = Field(ge=0, le=1, description="As in the record.")
    reasons: tuple[Kept, ...] = Field(
        fail_fast=True,
        default=(),
        max_length=MAX_LISTED,
        description="Headlines of the record's reasons.",
    )
    tracks: tuple[TrackSummary, ...] = Field(
        default=(),
        max_length=MAX_LISTED_TRACKS,
        exclude_if=lambda value: not value,
        description="The strongest of the record's tracks with a strength of at least 0.05, "
        "strongest first; absent without one, and from rows of earlier services.",
    )
    twin_of: Kept | None = Field(
        default=None,
        description="A better scene that shows the same things and is no twin itself: next to it "
        "in time, or of another drive past the same place.",
    )
    sha256: Kept = Field(description="Digest of the record as published.")
    place: ScenePlace | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Where it was recorded, as in the record; absent where that is not known, in "
        "published selections, and where verdicts were not requested.",
    )
    same_logs: tuple[Kept, ...] = Field(
        fail_fast=True,
        default=(),
        max_length=MAX_LISTED,
        exclude_if=lambda value: not value,
        description="Other logs with the same bytes, which have no scenes; absent without one, in "
        "published selections, and where verdicts were not requested.",
    )
    verdicts: VerdictSummary | None = Field(
        default=None,
        exclude_if=lambda value: value is None,
        description="Verdicts of reviewers; absent without one, in published selections, and "
        "where they were not requested.",
    )
