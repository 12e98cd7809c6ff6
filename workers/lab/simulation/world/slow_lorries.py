"""Slow lorries and buses: long smooth sides that pass the ego, or set off next to it."""

from typing import Final

from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.models.models import models_of
from workers.lab.simulation.world.motion_along_road import Knots, drive_along
from workers.lab.simulation.world.traffic import Traffic

CRUISE_M_PER_S: Final = (2.0, 4.0)
PER_LANE: Final = 2
REACH_M: Final = 22.0
"""Distance from the ego's way, in the middle of the log, at which such a vehicle is: metres."""

_SETS_OFF_SHARE: Final = 0.4
_RISE_S: Final = 3.0
"""Time a loaded lorry takes to its speed, seconds."""

_BUS_SHARE: Final = 0.3


def add_slow_lorries(traffic: Traffic) -> None:
    """Add slow lorries and buses to each lane of the main road, where there is room."""
    rng, road, place = traffic.rng, traffic.main, traffic.place
    middle_s = traffic.seconds / 2
    x, y, _ = traffic.ego.pose(middle_s)
    here_m = road.nearest_m(float(x), float(y))
    for backwards in (True, False):
        for lane_m in place.lanes_m:
            for _ in range(PER_LANE):
                what = StreetClass.BUS if rng.random() < _BUS_SHARE else StreetClass.TRUCK
                cruise = float(rng.uniform(*CRUISE_M_PER_S))
                speed: Knots = [(0.0, cruise), (traffic.seconds, cruise)]
                travelled_m = cruise * middle_s
                if rng.random() < _SETS_OFF_SHARE:
                    off_s = float(rng.uniform(0.15, 0.5)) * traffic.seconds
                    speed = [(0.0, 0.0), (off_s, 0.0), (off_s + _RISE_S, cruise)]
                    travelled_m = 0.0
                at_m = here_m + float(rng.uniform(-REACH_M, REACH_M))
                drive = drive_along(
                    road,
                    from_m=at_m + (travelled_m if backwards else -travelled_m),
                    across_m=lane_m if backwards else -lane_m,
                    speed=speed,
                    seconds=traffic.seconds,
                    backwards=backwards,
                )
                traffic.offer(what, drive, model=int(rng.integers(len(models_of(what)))))
