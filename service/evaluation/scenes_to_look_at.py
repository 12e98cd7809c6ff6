"""Scenes that a person looks at until most of the distinct planted failures are found."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from service.curation.candidates import Candidate
from service.curation.ranking import has_reason
from service.curation.strategies.catalogue import STRATEGIES, select
from service.evaluation.mined_fleet import FleetScene
from workers.lab.evaluation.failures.intervals import Interval, bootstrap

BY_SCORE: Final = "score"
"""Order of the ranking, in which a neighbour that shows the same is looked at again."""

FEWEST: Final = "fewest possible"
"""Order of one who knows the failures: the scene with the most that are not yet found is next."""

SHARES: Final = (0.5, 0.8, 0.9)

Shown = Callable[[FleetScene], frozenset[Any]]


class LooksRow(BaseModel):
    """Scenes to look at in one order."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    order: str
    found: str = Field(description="What is counted: failures, or pairs of kind and class.")
    scenes: int = Field(description="Scenes of the fleet.")
    distinct: int = Field(description="Distinct failures, or pairs, that they show.")
    looks: dict[str, int | None] = Field(
        description="Scenes until this share of them is found; null: more than there are."
    )
    intervals: dict[str, Interval | None] = Field(description="95 %, bootstrap over logs.")
    fewer: float | None = Field(
        description="Share of looks saved against the order of the score, for the last share."
    )
    fewer_interval: Interval | None = Field(description="95 %, of the same draws.")


def looks_rows(fleet: Sequence[FleetScene], *, draws: int) -> list[LooksRow]:
    """Measure every order on a fleet.

    Orders are made once, of the whole fleet. A draw takes logs with replacement, keeps the order of
    their scenes, and counts a log that is drawn twice as two.

    Args:
        fleet: Its scenes, best first.
        draws: Bootstrap draws; 0: no intervals.
    """
    rows = []
    for found, shown in (("failures", _failures), ("kind and class", _failing)):
        orders = {name: _whole(fleet, each) for name, each in _orders(fleet, shown).items()}
        rows += [
            _row(fleet, orders, name, found=found, shown=shown, draws=draws) for name in orders
        ]
    return rows


def _failures(scene: FleetScene) -> frozenset[Any]:
    return scene.failures


def _failing(scene: FleetScene) -> frozenset[Any]:
    return scene.failing


def _orders(fleet: Sequence[FleetScene], shown: Shown) -> dict[str, list[int]]:
    number = {each.candidate.scene.scene_id: at for at, each in enumerate(fleet)}
    candidates = [each.candidate for each in fleet]
    found = {BY_SCORE: list(range(len(fleet)))}
    for row in STRATEGIES:
        choices = select(candidates, budget=len(fleet), strategy=row.name)
        order = [number[each.scene.scene_id] for each in choices]
        if row.name == "best-distinct":  # under a budget that is never filled twins come last
            order = _twins_last(candidates, order)
        found[row.name] = order
    found[FEWEST] = _fewest(fleet, shown)
    return found


def _twins_last(candidates: Sequence[Candidate], order: Sequence[int]) -> list[int]:
    return sorted(order, key=lambda at: (candidates[at].scene.twin_of is not None, at))


def _fewest(fleet: Sequence[FleetScene], shown: Shown) -> list[int]:
    left, found, order = set(range(len(fleet))), set[Any](), list[int]()
    while left:
        best = max(left, key=lambda at: (len(shown(fleet[at]) - found), -at))
        if not shown(fleet[best]) - found:
            break
        left.discard(best)
        found |= shown(fleet[best])
        order.append(best)
    return order


def _whole(fleet: Sequence[FleetScene], order: Sequence[int]) -> NDArray[np.int64]:
    """Return an order of all scenes: what a strategy never chooses comes last, best first."""
    chosen = set(order)
    rest = [at for at in range(len(fleet)) if at not in chosen]
    rest.sort(key=lambda at: (not has_reason(fleet[at].candidate.scene), at))
    return np.array([*order, *rest], np.int64)


def _row(
    fleet: Sequence[FleetScene],
    orders: dict[str, NDArray[np.int64]],
    name: str,
    *,
    found: str,
    shown: Shown,
    draws: int,
) -> LooksRow:
    logs = [each.origin for each in fleet]
    numbers = np.unique(logs, return_inverse=True)[1].tolist()
    own, by_score = _places(orders[name]), _places(orders[BY_SCORE])
    by_log = found == "failures"

    def figures(drawn: NDArray[np.int64]) -> list[float | None]:
        looks = [_looks(fleet, drawn, own, share, shown, by_log=by_log) for share in SHARES]
        usual = _looks(fleet, drawn, by_score, SHARES[-1], shown, by_log=by_log)
        return [*looks, 1.0 - looks[-1] / usual if looks[-1] and usual else None]

    everything = figures(np.arange(len(fleet)))
    intervals = bootstrap(numbers, figures, draws=draws) if draws else [None] * len(everything)
    names = [f"{share:g}" for share in SHARES]
    fewer = everything[-1]
    return LooksRow(
        order=name,
        found=found,
        scenes=len(fleet),
        distinct=len({each for scene in fleet for each in shown(scene)}),
        looks={
            key: None if value is None else round(value)
            for key, value in zip(names, everything[:-1], strict=True)
        },
        intervals=dict(zip(names, intervals[:-1], strict=True)),
        fewer=None if fewer is None else round(fewer, 4),
        fewer_interval=intervals[-1],
    )


def _places(order: NDArray[np.int64]) -> NDArray[np.int64]:
    places = np.empty(len(order), np.int64)
    places[order] = np.arange(len(order))
    return places


def _looks(
    fleet: Sequence[FleetScene],
    drawn: NDArray[np.int64],
    places: NDArray[np.int64],
    share: float,
    shown: Shown,
    *,
    by_log: bool,
) -> float | None:
    """Return the scenes until a share of what the drawn scenes show is found."""
    copy = _copies(drawn) if by_log else np.zeros(len(drawn), np.int64)
    items = [
        [(number, each) for each in shown(fleet[at])]
        for at, number in zip(drawn.tolist(), copy.tolist(), strict=True)
    ]
    total = len({each for names in items for each in names})
    seen: set[Any] = set()
    for count, at in enumerate(np.argsort(places[drawn], kind="stable").tolist(), start=1):
        seen.update(items[at])
        if total and len(seen) >= share * total - 1e-9:
            return float(count)
    return None


def _copies(drawn: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how often each drawn scene was drawn before; a log drawn twice counts as two."""
    counts: dict[int, int] = {}
    found = np.empty(len(drawn), np.int64)
    for at, scene in enumerate(drawn.tolist()):
        found[at] = counts.get(scene, 0)
        counts[scene] = int(found[at]) + 1
    return found
