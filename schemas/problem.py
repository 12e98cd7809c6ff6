"""Error reply on the bus."""

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Text


class Problem(BaseModel):
    """Cause for which a request got no reply, in one sentence, and if a retry may help."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    problem: Text = Field(description="One sentence: what, where, and what to do.")
    transient: bool = Field(description="True if a later retry may help.")
