"""Attribution of a contradiction: the probability that each stream is wrong, and its evidence."""

from enum import StrEnum
from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Text

Chance = Annotated[float, Field(ge=0, le=1)]
"""A probability."""

MAX_EVIDENCE: Final = 6
"""Evidence phrases of one track at most, in all three lists: a record has to fit the bus."""

Phrases = tuple[Text, ...]


class Wrong(StrEnum):
    """Attributions on a track: the stream, or streams, whose labels are wrong."""

    SUPERVISED = "supervised"
    SELFSUPERVISED = "selfsupervised"
    BOTH = "both"
    NEITHER = "neither"


class Attribution(BaseModel):
    """Probabilities of the four attributions on a track; they add up to 1, up to rounding."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    wrong: Wrong = Field(description="The most probable of the four.")
    supervised: Chance = Field(description="That the supervised stream alone is wrong.")
    selfsupervised: Chance = Field(description="That the self-supervised stream alone is wrong.")
    both: Chance = Field(description="That both are wrong, and the witness right.")
    neither: Chance = Field(description="That both are right, and the witness wrong.")
    supporting: Phrases = Field(
        default=(),
        max_length=MAX_EVIDENCE,
        exclude_if=lambda value: not value,
        description="Evidence for what the attribution states of the supervised stream (wrong, or "
        "not wrong), the weightiest first; empty for tracks of low strength.",
    )
    opposing: Phrases = Field(
        default=(),
        max_length=MAX_EVIDENCE,
        exclude_if=lambda value: not value,
        description="Evidence against it, the weightiest first.",
    )
    neutral: Phrases = Field(
        default=(),
        max_length=MAX_EVIDENCE,
        exclude_if=lambda value: not value,
        description="Further facts about the track that neither support nor oppose it.",
    )

    @property
    def chance(self) -> float:
        """Probability of the most probable attribution."""
        return float(getattr(self, self.wrong.value))

    @property
    def supervised_wrong(self) -> float:
        """Probability that the supervised stream is wrong, alone or not."""
        return min(1.0, self.supervised + self.both)
