"""What comes with a published scene beside its record: its number, which the record must not hold.

Records of two runs compare byte for byte, whatever the order in which they were committed.
"""

from pydantic import BaseModel, ConfigDict, Field


class SceneNumber(BaseModel):
    """Attachment of every put and delete of a scene, live or from the history."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    seq: int = Field(ge=0, description="Rises by one per event over the whole ledger.")
