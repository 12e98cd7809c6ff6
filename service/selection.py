"""Which scenes go to the labellers: the best distinct ones under a budget. Pure."""

from collections.abc import Iterable
from itertools import islice, takewhile

from pydantic import BaseModel, ConfigDict, Field

from service.ranking import RankedScene


class Selection(BaseModel):
    """A named choice of scenes; it never changes once it is stored."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(min_length=1)
    budget: int = Field(ge=1, description="Scenes that were asked for.")
    scenes: tuple[RankedScene, ...] = Field(description="Best first, with the rank they had.")


def select(ranking: Iterable[RankedScene], *, budget: int) -> list[RankedScene]:
    """Choose the best distinct scenes.

    Twins are left out, because a labeller who sees the better neighbour sees the same street; so
    are scenes without any contradiction, even when the budget is not used up.

    Args:
        ranking: Best first; read only as far as needed.
        budget: Scenes the labellers can take, at least 1.

    Returns:
        At most `budget` scenes, best first.

    Raises:
        ValueError: If the budget is below 1.
    """
    if budget < 1:
        raise ValueError(f"budget must be at least 1 scene, got {budget}")
    contradicting = takewhile(lambda scene: scene.score > 0, ranking)
    return list(islice((scene for scene in contradicting if scene.twin_of is None), budget))
