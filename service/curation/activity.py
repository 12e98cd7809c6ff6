"""Activity over time: scenes and their disagreement, verdicts and precision. Pure."""

from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Count, Finite, Kept, StampNs
from service.curation.verdicts import Precision

MAX_BUCKETS: Final = 2000
"""Hours or days of a reply at most, the latest ones."""

MAX_GROUPS: Final = 1000
"""Groups of a reply at most, those with the most scenes."""

ActivityPer = Literal["hour", "day"]
ActivityBy = Literal["vehicle", "version", "kind"]

_STRICT: Final = ConfigDict(frozen=True, extra="forbid")


class ActivityRequest(BaseModel):
    """Request for the activity; scenes by time of recording, verdicts by time of judging."""

    model_config = _STRICT

    per: ActivityPer = "day"
    since_ns: StampNs = Field(default=0, description="At or after, ns since the epoch.")
    until_ns: StampNs | None = Field(default=None, description="Before; null: no end.")


class RecordedBucket(BaseModel):
    """Current scenes that were recorded in one hour or day."""

    model_config = _STRICT

    time_ms: Count = Field(description="Its start, ms since the Unix epoch.")
    scenes: Count
    disagreement_rate: Finite = Field(description="Contradicting over compared points, 0 to 1.")
    mean_score: Finite = Field(description="Over the scenes with a valid score; 0 without any.")


class JudgedBucket(BaseModel):
    """Verdicts that count and were given in one hour or day."""

    model_config = _STRICT

    time_ms: Count = Field(description="Its start, ms since the Unix epoch.")
    verdicts: Count
    precision: Precision = Field(description="Of the scenes judged in it.")
    so_far: Precision = Field(description="Of all scenes judged up to its end.")


class ActivityGroup(BaseModel):
    """Current scenes of one vehicle, software version or kind, and the verdicts on them."""

    model_config = _STRICT

    by: ActivityBy
    group: Kept
    scenes: Count
    disagreement_rate: Finite = Field(description="Contradicting over compared points, 0 to 1.")
    verdicts: Count
    precision: Precision


class ActivityReply(BaseModel):
    """Activity by time and by group."""

    model_config = _STRICT

    recorded: tuple[RecordedBucket, ...] = Field(max_length=MAX_BUCKETS)
    judged: tuple[JudgedBucket, ...] = Field(max_length=MAX_BUCKETS)
    groups: tuple[ActivityGroup, ...] = Field(max_length=3 * MAX_GROUPS)
