"""Messages published in addition to records: event numbers, and the scenes of a selection.

A record must not contain its event number. Records of two runs compare byte for byte, whatever the
order in which they were committed.
"""

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import MAX_LISTED, Count, Kept, StampNs


class SceneNumber(BaseModel):
    """Attachment of every put and delete of a scene, live or from the history."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    seq: Count = Field(description="Rises by one per event over the whole ledger.")


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
        default=(), max_length=MAX_LISTED, description="Headlines of the record's reasons."
    )
    twin_of: Kept | None = Field(default=None, description="A better scene next to it.")
    sha256: Kept = Field(description="Digest of the record as published.")
