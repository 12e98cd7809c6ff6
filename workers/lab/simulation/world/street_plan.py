"""Street plan: kind of street, driving style of the ego, hardships."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.world.street_kinds import PlaceName

EgoStyle = Literal["stands", "drives", "stops_and_goes", "turns"]
EGO_STYLES: Final[tuple[EgoStyle, ...]] = ("stands", "drives", "stops_and_goes", "turns")

Hardship = Literal["dense traffic", "vegetation", "turns", "bumps"]
HARDSHIPS: Final[tuple[Hardship, ...]] = ("dense traffic", "vegetation", "turns", "bumps")


@dataclass(frozen=True, slots=True)
class StreetPlan:
    """Plan of a street; everything else is drawn from its seed.

    Attributes:
        place: Kind of street.
        style: Driving style of the ego; None lets the seed choose.
        hard: Hardships of the street, if any.
        steep: Steepest grade.
        rain_share: Share of beams returned by drops.
        dust: Whether vehicles and wind raise dust.
        unsettling: Whether it contains many movers that are easily mistaken for standing.
        slow_lorries: Whether lorries and buses pass the ego at 2 to 4 m/s, or set off next to it.
        without: Classes of road users that it lacks.
    """

    place: PlaceName = "town"
    style: EgoStyle | None = None
    hard: tuple[Hardship, ...] = ()
    steep: float = 0.01
    rain_share: float = 0.0
    dust: bool = False
    unsettling: bool = False
    slow_lorries: bool = False
    without: tuple[StreetClass, ...] = ()


def draw_plan(rng: np.random.Generator, *, hard: bool) -> StreetPlan:
    """Draw the plan of a street of a fleet.

    Args:
        rng: Random generator.
        hard: Whether the street has two or more of `HARDSHIPS`.
    """
    places: list[PlaceName] = ["town", "suburb", "highway", "country"]
    place = places[int(rng.choice(4, p=[0.4, 0.25, 0.2, 0.15]))]
    style = EGO_STYLES[int(rng.choice(4, p=[0.2, 0.4, 0.25, 0.15]))]
    chosen: tuple[Hardship, ...] = ()
    if hard:
        possible = [
            h for h in HARDSHIPS if place != "highway" or h in ("dense traffic", "vegetation")
        ]
        count = min(int(rng.integers(2, 4)), len(possible))
        picked = sorted(rng.choice(len(possible), count, replace=False).tolist())
        chosen = tuple(possible[k] for k in picked)
    if "turns" in chosen:
        style = "turns"
    elif place == "highway" or style == "turns":
        style = "drives"
    return StreetPlan(
        place=place,
        style=style,
        hard=chosen,
        steep=float(rng.uniform(0.02, 0.07)) if "bumps" in chosen else float(rng.uniform(0, 0.03)),
        rain_share=float(rng.uniform(0.002, 0.02)) if rng.random() < 0.12 else 0.0,
        dust=bool(rng.random() < 0.12),
    )
