"""Which log is made of a number: its encoding, its container and what is done to it."""

import random
from typing import Final

from tests.fuzz.container import Draft
from tests.fuzz.mutations import MUTATIONS, mutate
from tests.fuzz.seeds import ENCODINGS, any_seed

OTHERS: Final = (0, 0, 1, 2)
"""How many mutations follow the first one."""


def case(seed: int, number: int) -> tuple[str, tuple[str, ...], Draft]:
    """Make the log of a number; the numbers go round all encodings and first mutations.

    Returns:
        Its encoding, its mutations, and the draft of it.
    """
    chance = random.Random(f"{seed} {number}")  # noqa: S311  # the same number, the same log
    encoding = list(ENCODINGS)[number % len(ENCODINGS)]
    first = list(MUTATIONS)[number // len(ENCODINGS) % len(MUTATIONS)]
    names = (first, *chance.choices(list(MUTATIONS), k=chance.choice(OTHERS)))
    draft = any_seed(chance, encoding)
    mutate(draft, chance, names)
    return encoding, names, draft
