"""Runs inputs that hypothesis makes from seeds, in parts: equal seeds make equal inputs."""

from collections.abc import Callable
from contextlib import suppress
from typing import Final, TypeVar

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable

Made = TypeVar("Made")

PART: Final = 500
"""Inputs of one seed; hypothesis remembers every input of a part, large ones too."""


def run_parts(
    inputs: st.SearchStrategy[Made],
    act: Callable[[Made], None],
    *,
    examples: int,
    first_seed: int = 0,
) -> None:
    """Act on so many inputs.

    Args:
        inputs: Makes them.
        act: Called with each.
        examples: How many.
        first_seed: Seed of the first part; each further part has the next one.
    """
    for part, first in enumerate(range(0, examples, PART), start=first_seed):
        run_part(inputs, act, examples=min(PART, examples - first), of_seed=part)


def run_part(
    inputs: st.SearchStrategy[Made], act: Callable[[Made], None], *, examples: int, of_seed: int
) -> None:
    """Act on the inputs of one seed; none if nothing fits the strategy.

    Args:
        inputs: Makes them.
        act: Called with each.
        examples: How many.
        of_seed: The seed.
    """

    @seed(of_seed)
    @settings(
        max_examples=examples,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(inputs)
    def each(made: Made) -> None:
        act(made)

    with suppress(Unsatisfiable):
        each()
