"""Orders in which the scenes of a mined fleet are labelled, each under a budget. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from service.curation.strategies.catalogue import DEFAULT, select
from service.evaluation.mined_fleet import FleetScene

BY_SCORE: Final = "score"
RANDOM: Final = "random"
ENTROPY: Final = "entropy"
POINT_SHARE: Final = "point share"

ORDERS: Final = (BY_SCORE, DEFAULT, RANDOM, ENTROPY, POINT_SHARE)
"""Counterpoint's score, its default selection, and the three orders that it is compared with."""

OWN: Final = (BY_SCORE, DEFAULT)
"""Orders of Counterpoint."""


@dataclass(frozen=True, slots=True, order=True)
class SceneKey:
    """A scene of the fleet: its log, and its number in the log."""

    log_id: str
    cell: int


def chosen_by(
    order: str,
    fleet: Sequence[FleetScene],
    entropy: Mapping[str, float],
    *,
    budget: int,
    seed: int,
) -> list[SceneKey]:
    """Choose the scenes that are labelled.

    Args:
        order: One of `ORDERS`.
        fleet: Scenes of the mined fleet, best first.
        entropy: Mean entropy of the model, by scene.
        budget: Scenes to choose; the default selection may choose fewer, for it takes no scene
            without a reason.
        seed: Seed of the random order, which a larger budget continues.

    Returns:
        The scenes, in the order in which they were chosen.
    """
    ranked = list(fleet)
    if order == DEFAULT:
        of = {each.candidate.scene.scene_id: each for each in fleet}
        choices = select([each.candidate for each in fleet], budget=budget)
        ranked = [of[each.scene.scene_id] for each in choices]
    elif order == RANDOM:
        drawn = np.random.default_rng([seed, 0x5A11]).permutation(len(fleet))
        by_name = sorted(fleet, key=_name)
        ranked = [by_name[place] for place in drawn.tolist()]
    elif order == ENTROPY:
        ranked.sort(key=lambda each: (-entropy[each.row.scene_id], _name(each)))
    elif order == POINT_SHARE:
        ranked.sort(key=lambda each: (-each.row.views["point_share"], _name(each)))
    elif order != BY_SCORE:
        raise ValueError(f"order must be one of {', '.join(ORDERS)}, got {order!r}")
    return [SceneKey(each.candidate.scene.log_id, each.row.cell) for each in ranked[:budget]]


def _name(scene: FleetScene) -> tuple[str, int]:
    return scene.candidate.scene.log_id, scene.row.cell
