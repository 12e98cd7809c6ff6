"""Attribution: which stream is probably wrong about a contradicting object, and the evidence."""

from enum import StrEnum
from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.bounds import Text

Chance = Annotated[float, Field(ge=0, le=1)]
"""A probability."""

MOST_WORDS: Final = 6
"""Number of names in `because`, `against` and `also` together; a record has to fit the bus."""

Words = tuple[Text, ...]


class Wrong(StrEnum):
    """Stream or streams that are wrong about an object."""

    SUPERVISED = "supervised"
    SELFSUPERVISED = "selfsupervised"
    BOTH = "both"
    NEITHER = "neither"


class Attribution(BaseModel):
    """Attribution of one track; the four probabilities add up to 1, but for rounding."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    wrong: Wrong = Field(description="The likeliest of the four.")
    supervised: Chance = Field(description="That the supervised stream alone is wrong.")
    selfsupervised: Chance = Field(description="That the self-supervised stream alone is wrong.")
    both: Chance = Field(description="That both are wrong, and the witness right.")
    neither: Chance = Field(description="That both are right, and the witness wrong.")
    because: Words = Field(
        default=(),
        max_length=MOST_WORDS,
        exclude_if=lambda value: not value,
        description="What speaks for what it says of the supervised stream (wrong, or not), the "
        "weightiest first; of tracks hardly worth a look no word is told.",
    )
    against: Words = Field(
        default=(),
        max_length=MOST_WORDS,
        exclude_if=lambda value: not value,
        description="What speaks against that, the weightiest first.",
    )
    also: Words = Field(
        default=(),
        max_length=MOST_WORDS,
        exclude_if=lambda value: not value,
        description="What else is known of the track and speaks neither for nor against it.",
    )

    @property
    def chance(self) -> float:
        """Return the largest of the four probabilities."""
        return float(getattr(self, self.wrong.value))

    @property
    def supervised_wrong(self) -> float:
        """Probability that the supervised stream is wrong, alone or together with the other."""
        return min(1.0, self.supervised + self.both)
