"""An error as it is answered over the bus."""

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Text


class Problem(BaseModel):
    """Why a question got no answer, in one sentence, and whether asking again may help."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    problem: Text = Field(description="One sentence: what, where, and what to do.")
    transient: bool = Field(description="Asking again later may help.")
