"""Traffic of a street: lanes with queues and turns, pedestrians, pets, parked cars."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from workers.lab.simulation.models.kinds import VEHICLES, StreetClass
from workers.lab.simulation.models.mixes import LANE_MIX, PARKED_MIX
from workers.lab.simulation.models.models import models_of
from workers.lab.simulation.world.motion_along_road import (
    Drive,
    Floats,
    Knots,
    Road,
    drive_across,
    drive_along,
    drive_with_care,
    stand,
    turning_route,
)
from workers.lab.simulation.world.occupancy import Occupancy
from workers.lab.simulation.world.slow_walkers import draw_stroll
from workers.lab.simulation.world.street import Actor
from workers.lab.simulation.world.street_kinds import Place

_SEEN_M: Final = 115.0
"""Distance from the ego beyond which an actor is left out, metres."""


@dataclass(slots=True, eq=False)
class Traffic:
    """Fills a street; each new actor is placed if there is room, or left out.

    Attributes:
        main: The road the ego starts on.
        place: Its kind.
        crossings: Roads over it, with the path length of the main road where each crosses.
        ego: Drive of the ego.
        seconds: Duration.
        dense: Factor of traffic density; 1 is usual.
        rng: Random generator of the street.
        without: Classes that are left out.
    """

    main: Road
    place: Place
    crossings: Sequence[tuple[float, Road, Place]]
    ego: Drive
    seconds: float
    dense: float
    rng: np.random.Generator
    without: Collection[StreetClass] = ()
    actors: list[Actor] = field(default_factory=list)
    _taken: Occupancy = field(init=False)
    _ego_way: Floats = field(init=False)

    def __post_init__(self) -> None:
        """Reserve the ego's space first."""
        self._taken = Occupancy(self.seconds)
        self._taken.add(self.ego, (4.6, 1.9, 1.5))
        self._ego_way = self.ego.pose(np.arange(0.0, self.seconds, 0.5))

    def park(self, from_m: float, to_m: float) -> None:
        """Fill about half the parking places along the main road and the crossing streets."""
        roads = [(self.main, self.place, from_m, to_m)]
        roads += [(road, place, -110.0, 110.0) for _, road, place in self.crossings]
        for number, (road, place, low, high) in enumerate(roads):
            if place.parking_m == 0.0:
                continue
            for side in (1, -1):
                for at in np.arange(low + 4.0, high - 4.0, 6.6):
                    taken = self.rng.random() < 0.55
                    wiggle, turn = self.rng.uniform(-0.4, 0.4), self.rng.normal(0.0, 0.02)
                    what = self._drawn(PARKED_MIX)
                    if not taken or self._at_junction(number, float(at)):
                        continue
                    model = self._model(what, small=True)
                    facing = np.pi if (side > 0) != (self.rng.random() < 0.1) else 0.0
                    drive = stand(
                        road,
                        at_m=float(at + wiggle),
                        across_m=side * (place.parking_m + 0.04 * wiggle),
                        turned_rad=float(turn + facing),
                    )
                    self._offer(what, drive, model=model, parked=True)

    def move(self) -> None:
        """Add all kinds of movers, the rarer ones first."""
        if self.place.parking_m > 0.0:
            self._reversing()
        for junction, road, place in self.crossings:
            self._turning(road, place)
            self._walk_over(junction)
        self._lanes(self.main, self.place, main=True)
        for _, road, place in self.crossings:
            self._lanes(road, place, main=False)
        self._cyclists()
        self._people()
        self._animals()

    def unsettle(self) -> None:
        """Add movers that are easily mistaken for standing: very long, very slow, or by a wall."""
        rng, place = self.rng, self.place
        long_ones = ((StreetClass.BUS, "articulated bus"), (StreetClass.TRUCK, "road train"))
        for backwards in (True, False, True):
            what, name = long_ones[int(rng.integers(len(long_ones)))]
            model = [each.name for each in models_of(what)].index(name)
            lane_m = place.lanes_m[-1] if not backwards else place.lanes_m[0]
            lane = self.main.lane(lane_m * (1 if backwards else -1), backwards=backwards)
            cruise = float(rng.uniform(*place.cruise_m_per_s))
            low, high = self._window(lane, cruise)
            drive = drive_with_care(
                lane,
                from_m=float(rng.uniform(low + 60.0, max(high - 60.0, low + 61.0))),
                across_m=0.0,
                cruise_m_per_s=cruise,
                seconds=self.seconds,
            )
            self._offer(what, drive, model=model)
        if place.people_per_100_m == 0.0:
            return
        for along in self._stretches(14.0):
            side = 1 if rng.random() < 0.5 else -1
            walk, across = draw_stroll(place, rng)
            drive = drive_along(
                self.main,
                from_m=along,
                across_m=side * across,
                speed=self._steady(walk),
                seconds=self.seconds,
                backwards=bool(rng.random() < 0.5),
            )
            self._offer(StreetClass.PEDESTRIAN, drive)

    def offer(self, what: StreetClass, drive: Drive, *, model: int) -> None:
        """Add an object with the given drive, if there is room."""
        self._offer(what, drive, model=model)

    def offer_companion(self, drive: Drive) -> None:
        """Add a vehicle with the given drive, if there is room."""
        self._offer(self._drawn(LANE_MIX[:2]), drive)

    def _steady(self, m_per_s: float) -> Knots:
        return [(0.0, m_per_s), (self.seconds, m_per_s)]

    def _drawn(self, mix: Sequence[tuple[StreetClass, float]]) -> StreetClass:
        shares = np.array([share for _, share in mix])
        return mix[int(self.rng.choice(len(mix), p=shares / shares.sum()))][0]

    def _model(self, what: StreetClass, *, small: bool = False) -> int:
        models = len(models_of(what))
        return 0 if small and what is StreetClass.TRUCK else int(self.rng.integers(models))

    def _offer(
        self, what: StreetClass, drive: Drive, *, model: int | None = None, parked: bool = False
    ) -> bool:
        chosen = self._model(what) if model is None else model
        middle, spread = (-2.4, 0.9) if what in VEHICLES else (-1.1, 0.5)
        shine = float(np.clip(self.rng.lognormal(middle, spread), 0.02, 0.9))
        actor = Actor(what, drive, parked=parked, model=chosen, reflectivity=shine)
        way = drive.pose(np.arange(0.0, self.seconds, 0.5))
        if np.hypot(*(way - self._ego_way)[:, :2].T).min() > _SEEN_M:
            return False
        if what in self.without or not self._taken.take(drive, actor.size_m):
            return False
        self.actors.append(actor)
        return True

    def _at_junction(self, number: int, at_m: float) -> bool:
        if number > 0:
            return abs(at_m) < self.place.kerb_m + 5.0
        return any(abs(at_m - j) < p.kerb_m + 5.0 for j, _, p in self.crossings)

    def _lanes(self, road: Road, place: Place, *, main: bool) -> None:
        for backwards in (False, True):
            for lane_m in place.lanes_m if main else place.lanes_m[:1]:
                across = lane_m if backwards else -lane_m
                self._lane(road.lane(across, backwards=backwards), place, main=main)

    def _lane(self, lane: Road, place: Place, *, main: bool) -> None:
        """Fill one lane; a red light stops its traffic for a while."""
        rng = self.rng
        cruise = float(rng.uniform(*place.cruise_m_per_s))
        stop_m, green_s = np.inf, 0.0
        if self.crossings and rng.random() < (0.4 if main else 0.7):
            stop_m = self._stop_line(lane, main=main)
            green_s = float(rng.uniform(0.2, 1.1)) * self.seconds
        slot_m = self._window(lane, cruise)
        at, waiting = slot_m[1], 0
        while at > slot_m[0]:
            what = self._drawn(LANE_MIX)
            drive = drive_with_care(
                lane, from_m=at, across_m=0.0, cruise_m_per_s=cruise, seconds=self.seconds
            )
            halt = stop_m - 10.0 * waiting
            if at < halt < np.inf:
                arrives_s = (halt - at) / cruise + 1.0
                if arrives_s < green_s + 1.5 * waiting:
                    rest_s = green_s + 1.5 * waiting - arrives_s
                    drive = drive_with_care(
                        lane,
                        from_m=at,
                        across_m=0.0,
                        cruise_m_per_s=cruise,
                        seconds=self.seconds,
                        halts=[(halt, rest_s)],
                    )
                    waiting += 1
            self._offer(what, drive)
            gap = float(rng.uniform(*place.gap_m)) / self.dense
            at -= max(gap * (1.0 if main else 1.6), 14.0)

    def _stop_line(self, lane: Road, *, main: bool) -> float:
        """Return the path length of the stop line at the junction nearest to the ego's route."""
        ahead = self._ego_way[len(self._ego_way) // 2, :2]
        middles = [road.place(0.0, 0.0)[:2] for _, road, _ in self.crossings]
        x, y = min(middles, key=lambda m: float(np.hypot(m[0] - ahead[0], m[1] - ahead[1])))
        width = max(place.kerb_m for _, _, place in self.crossings) if main else self.place.kerb_m
        return lane.nearest_m(float(x), float(y)) - width - 4.0

    def _window(self, lane: Road, cruise_m_per_s: float) -> tuple[float, float]:
        """Return the range of start positions from which a vehicle may come near the ego."""
        near = [
            lane.nearest_m(x, y) for x, y, _ in self._ego_way[:: max(len(self._ego_way) // 4, 1)]
        ]
        low = max(min(near) - 100.0 - cruise_m_per_s * self.seconds, 0.0)
        return low, min(max(near) + 100.0, float(lane.along_m[-1]))

    def _turning(self, road: Road, place: Place) -> None:
        """Add vehicles that turn from the main road into the crossing one, or out of it."""
        rng = self.rng
        for _ in range(round(2 * self.dense)):
            leftwards, out = bool(rng.random() < 0.5), bool(rng.random() < 0.5)
            backwards = bool(rng.random() < 0.5)
            main_lane = self.main.lane(
                self.place.lanes_m[0] * (1 if backwards else -1), backwards=backwards
            )
            side_backwards = leftwards == backwards
            side_lane = road.lane(
                place.lanes_m[0] * (1 if side_backwards else -1), backwards=side_backwards
            )
            x, y, _ = (float(v) for v in road.place(0.0, 0.0))
            here, there = main_lane.nearest_m(x, y), side_lane.nearest_m(x, y)
            if out:
                route = turning_route(
                    main_lane, here - place.kerb_m, side_lane, there + self.place.kerb_m
                )
            else:
                route = turning_route(
                    side_lane, there - self.place.kerb_m, main_lane, here + place.kerb_m
                )
            bend = route.nearest_m(x, y)
            cruise = float(rng.uniform(6.0, 10.0))
            starts = bend - cruise * float(rng.uniform(0.0, 0.7)) * self.seconds
            drive = drive_with_care(
                route,
                from_m=max(starts, 0.0),
                across_m=0.0,
                cruise_m_per_s=cruise,
                seconds=self.seconds,
            )
            self._offer(self._drawn(LANE_MIX), drive)

    def _walk_over(self, junction_m: float) -> None:
        rng, place = self.rng, self.place
        reach = place.kerb_m + 3.0
        for _ in range(round(2 * self.dense)):
            walk = float(rng.uniform(0.7, 1.8))
            leftwards = bool(rng.random() < 0.5)
            side = -1 if rng.random() < 0.6 else 1
            drive = drive_across(
                self.main,
                at_m=junction_m + side * (place.kerb_m + float(rng.uniform(0.5, 3.0))),
                from_across_m=(-1 if leftwards else 1) * float(rng.uniform(0.3, 1.0)) * reach,
                speed=self._steady(walk),
                seconds=min(self.seconds, 2 * reach / walk),
                leftwards=leftwards,
            )
            self._offer(StreetClass.PEDESTRIAN, drive)

    def _reversing(self) -> None:
        """Add cars that reverse out of a parking place, or of a driveway across the pavement."""
        rng, place = self.rng, self.place
        for along in self._stretches(140.0 / self.dense):
            late = float(rng.uniform(0.0, 0.5)) * self.seconds
            speed = [
                (0.0, 0.0),
                (late, 0.0),
                (late + 1.5, 1.6),
                (late + 4.5, 1.4),
                (late + 6.0, 0.0),
            ]
            side = 1 if rng.random() < 0.5 else -1
            if rng.random() < 0.5 or not place.gardens:
                drive = drive_along(
                    self.main,
                    from_m=along,
                    across_m=side * place.parking_m,
                    speed=speed,
                    seconds=self.seconds,
                    backwards=side < 0,
                    reversing=True,
                )
            else:
                drive = drive_across(
                    self.main,
                    at_m=along,
                    from_across_m=side * (place.kerb_m + place.pavement_m + 3.0),
                    speed=speed,
                    seconds=self.seconds,
                    leftwards=side < 0,
                )
                drive = Drive(drive.time_s, drive.x_m, drive.y_m, drive.yaw_rad + np.pi)
            self._offer(StreetClass.CAR, drive)

    def _cyclists(self) -> None:
        rng, place = self.rng, self.place
        if place.cycle_m == 0.0:
            return
        for along in self._stretches(45.0 / self.dense):
            ride = float(rng.uniform(3.0, 7.0))
            backwards = bool(rng.random() < 0.5)
            drive = drive_along(
                self.main,
                from_m=along,
                across_m=place.cycle_m * (1 if backwards else -1) + float(rng.normal(0.0, 0.15)),
                speed=self._steady(ride),
                seconds=self.seconds,
                backwards=backwards,
            )
            self._offer(StreetClass.CYCLIST, drive)

    def _people(self) -> None:
        """Add pedestrians who walk, stand, run, push prams, and step out between parked cars."""
        rng, place = self.rng, self.place
        if place.people_per_100_m == 0.0:
            return
        reach = max(place.pavement_m, 1.6)
        for along in self._stretches(50.0 / (place.people_per_100_m * self.dense)):
            side = 1 if rng.random() < 0.5 else -1
            across = side * (place.kerb_m + float(rng.uniform(0.9, min(reach, 3.4) + 0.1)))
            draw = rng.random()
            walk = float(rng.uniform(0.5, 1.9)) if draw < 0.8 else float(rng.uniform(2.4, 3.6))
            if draw < 0.12:
                walk = 0.0
            if rng.random() < 0.12:
                drive = drive_across(
                    self.main,
                    at_m=along,
                    from_across_m=across,
                    speed=self._steady(walk),
                    seconds=min(self.seconds, 2 * abs(across) / max(walk, 0.5)),
                    leftwards=side < 0,
                )
            else:
                drive = drive_along(
                    self.main,
                    from_m=along,
                    across_m=across,
                    speed=self._steady(walk),
                    seconds=self.seconds,
                    backwards=bool(rng.random() < 0.5),
                )
            kept = self._offer(StreetClass.PEDESTRIAN, drive)
            if kept and walk > 0 and rng.random() < 0.12:
                aside = drive.pose(drive.time_s)
                x = drive.x_m - np.sin(aside[:, 2]) * 1.5
                y = drive.y_m + np.cos(aside[:, 2]) * 1.5
                pet = Drive(drive.time_s, x, y, drive.yaw_rad)
                self._offer(StreetClass.ANIMAL, pet, model=int(rng.choice([0, 2])))

    def _animals(self) -> None:
        """Add a deer, or an unleashed dog, that runs over a quiet road."""
        rng = self.rng
        if self.place.barriers or rng.random() > 0.6:
            return
        for along in self._stretches(150.0):
            run = float(rng.uniform(1.0, 6.0))
            reach = self.place.kerb_m + 6.0
            leftwards = bool(rng.random() < 0.5)
            drive = drive_across(
                self.main,
                at_m=along,
                from_across_m=(-1 if leftwards else 1) * float(rng.uniform(0.4, 1.0)) * reach,
                speed=self._steady(run),
                seconds=min(self.seconds, 2 * reach / run),
                leftwards=leftwards,
            )
            deer = self.place.gardens and self.place.name == "country"
            self._offer(StreetClass.ANIMAL, drive, model=1 if deer else 0)

    def _stretches(self, every_m: float) -> Iterator[float]:
        """Yield path lengths along the ego's route, about this far apart."""
        at = [self.main.nearest_m(x, y) for x, y, _ in self._ego_way[[0, -1]]]
        where, end = min(at) - 30.0, max(at) + 60.0
        while where < end:
            where += float(self.rng.uniform(0.3, 1.7)) * every_m
            yield where
