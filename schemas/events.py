"""What is published beside the records: the number of an event, and the scenes of a selection.

A record must not hold its number: records of two runs compare byte for byte, whatever the order in
which they were committed.
"""

from pydantic import BaseModel, ConfigDict, Field


class SceneNumber(BaseModel):
    """Attachment of every put and delete of a scene, live or from the history."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    seq: int = Field(ge=0, description="Rises by one per event over the whole ledger.")


class RankedScene(BaseModel):
    """One row of the ranking or of a selection, as `counterpoint top --json` prints it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rank: int = Field(ge=1, description="Place in the ranking, 1 first.")
    scene_id: str = Field(description="`<log_id>/<lidar>/<start_ns>`.")
    log_id: str = Field(description="Bucket-relative key of the recording.")
    start_ns: int = Field(ge=0, description="First frame, nanoseconds since the Unix epoch.")
    end_ns: int = Field(ge=0, description="Last frame, nanoseconds since the Unix epoch.")
    score: float = Field(ge=0, le=1, description="As in the record.")
    reasons: tuple[str, ...] = Field(default=(), description="As in the record.")
    twin_of: str | None = Field(default=None, description="A better scene right beside it.")
    sha256: str = Field(description="Digest of the record as published.")
