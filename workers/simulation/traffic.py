"""Who moves in a street: parked and driving cars, crossing ones, pedestrians, a cyclist."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from workers.simulation.drive import Drive, Knots, Road, drive_across, drive_along, stand
from workers.simulation.kinds import SIZE_M, StreetClass
from workers.simulation.scenery import FACADE_M, JUNCTION_HALF_M, KERB_M
from workers.simulation.street import Actor

EGO_LANE_M: Final = -1.8
"""Traffic keeps right: the ego's lane lies right of the centre line."""

_SECOND_LANE_M: Final = 5.3
_PARKING_M: Final = 8.5
_CYCLE_LANE_M: Final = 7.0
_KEEP_APART_M: Final = 1.0


def parked_cars(
    road: Road, *, from_m: float, to_m: float, junctions_m: list[float], rng: np.random.Generator
) -> list[Actor]:
    """Fill about half the places along both kerbs."""
    cars = []
    for side in (1, -1):
        for at in np.arange(from_m + 4.0, to_m - 4.0, 6.4):
            taken = rng.random() < 0.55
            wiggle_m, turn = rng.uniform(-0.4, 0.4), rng.normal(0.0, 0.02)
            if not taken or any(abs(at - j) < JUNCTION_HALF_M + 5.0 for j in junctions_m):
                continue
            turned = turn + (np.pi if side > 0 else 0.0)
            across = side * _PARKING_M + 0.2 * wiggle_m
            drive = stand(road, at_m=at + wiggle_m, across_m=across, turned_rad=turned)
            cars.append(Actor(StreetClass.CAR, drive, parked=True))
    return cars


def moving_traffic(
    road: Road,
    *,
    ego: Drive,
    ego_speed: Knots,
    seconds: float,
    junctions_m: list[float],
    rng: np.random.Generator,
) -> list[Actor]:
    """Let cars, people and a cyclist move along and across the road, none through another."""
    travelled = float(np.hypot(np.diff(ego.x_m), np.diff(ego.y_m)).sum())
    kept: list[Actor] = []
    for actor in [
        *_companions(road, ego_speed, seconds, rng),
        *_crossing(road, travelled, seconds, junctions_m, rng),
        *_oncoming(road, travelled, seconds, rng),
        *_overtaking(road, seconds, rng),
        *_on_pavements(road, travelled, seconds, rng),
    ]:
        if _clear_of(actor.drive, actor.street_class, [(ego, StreetClass.CAR)], seconds) and (
            _clear_of(
                actor.drive, actor.street_class, [(k.drive, k.street_class) for k in kept], seconds
            )
        ):
            kept.append(actor)
    return kept


def _companions(
    road: Road, ego_speed: Knots, seconds: float, rng: np.random.Generator
) -> list[Actor]:
    """A leader that does a little earlier what the ego does, and perhaps one behind."""
    actors = []
    for gap_m, ahead_s in (
        (float(rng.uniform(11.0, 18.0)), 1.2),
        (-float(rng.uniform(9, 14)), -1.2),
    ):
        if rng.random() < 0.7:
            speed = [(t - ahead_s, v) for t, v in ego_speed]
            drive = drive_along(
                road,
                from_m=gap_m,
                across_m=EGO_LANE_M,
                speed=speed,
                seconds=seconds,
                backwards=False,
            )
            actors.append(Actor(StreetClass.CAR, drive))
    return actors


def _crossing(
    road: Road,
    travelled_m: float,
    seconds: float,
    junctions_m: list[float],
    rng: np.random.Generator,
) -> list[Actor]:
    actors = []
    for junction in junctions_m:
        for _ in range(3):
            leftwards = bool(rng.random() < 0.5)
            speed = float(rng.uniform(5.0, 9.0))
            meets_s = float(rng.uniform(1.0, max(seconds - 1.0, 2.0)))
            lane = junction + (2.5 if leftwards else -2.5)
            drive = drive_across(
                road,
                at_m=lane,
                from_across_m=(-1 if leftwards else 1) * speed * meets_s,
                speed=[(0.0, speed), (seconds, speed)],
                seconds=seconds,
                leftwards=leftwards,
            )
            actors.append(Actor(StreetClass.CAR, drive))
        if -10.0 < junction < travelled_m + 40.0:
            leftwards = bool(rng.random() < 0.5)
            walk = float(rng.uniform(1.1, 1.7))
            drive = drive_across(
                road,
                at_m=junction - JUNCTION_HALF_M - 2.0,
                from_across_m=(-1 if leftwards else 1) * float(rng.uniform(6.0, FACADE_M - 1.0)),
                speed=[(0.0, walk), (seconds, walk)],
                seconds=min(seconds, 2 * FACADE_M / walk),
                leftwards=leftwards,
            )
            actors.append(Actor(StreetClass.PEDESTRIAN, drive))
    return actors


def _oncoming(
    road: Road, travelled_m: float, seconds: float, rng: np.random.Generator
) -> list[Actor]:
    actors = []
    for lane in (-EGO_LANE_M, _SECOND_LANE_M):
        speed = float(rng.uniform(6.0, 12.0))
        at = float(rng.uniform(15.0, 45.0))
        while at < travelled_m + speed * seconds + 80.0:
            what = StreetClass.TRUCK if rng.random() < 0.15 else StreetClass.CAR
            drive = drive_along(
                road,
                from_m=at,
                across_m=lane,
                speed=[(0.0, speed), (seconds, speed)],
                seconds=seconds,
                backwards=True,
            )
            actors.append(Actor(what, drive))
            at += float(rng.uniform(18.0, 55.0))
    return actors


def _overtaking(road: Road, seconds: float, rng: np.random.Generator) -> list[Actor]:
    """Cars in the lane to our right: faster, slower, or stopping for a while."""
    actors = []
    cruise = float(rng.uniform(4.0, 11.0))
    stops_s = float(rng.uniform(0.2, 0.8)) * seconds
    for at in (-float(rng.uniform(12.0, 40.0)), float(rng.uniform(8.0, 30.0))):
        halt: Knots = [
            (0.0, cruise),
            (stops_s, cruise),
            (stops_s + cruise / 3.0, 0.0),
            (stops_s + cruise / 3.0 + 2.5, 0.0),
            (stops_s + cruise / 3.0 + 5.0, cruise),
        ]
        drive = drive_along(
            road,
            from_m=at,
            across_m=-_SECOND_LANE_M,
            speed=halt if at > 0 else [(0.0, cruise), (seconds, cruise)],
            seconds=seconds,
            backwards=False,
        )
        actors.append(Actor(StreetClass.CAR, drive))
    ride = float(rng.uniform(3.5, 6.0))
    drive = drive_along(
        road,
        from_m=float(rng.uniform(-15.0, 25.0)),
        across_m=-_CYCLE_LANE_M,
        speed=[(0.0, ride), (seconds, ride)],
        seconds=seconds,
        backwards=False,
    )
    return [*actors, Actor(StreetClass.CYCLIST, drive)]


def _on_pavements(
    road: Road, travelled_m: float, seconds: float, rng: np.random.Generator
) -> list[Actor]:
    actors = []
    for _ in range(4 + int(travelled_m / 60.0)):
        side = 1 if rng.random() < 0.5 else -1
        walk = float(rng.uniform(0.9, 1.7))
        drive = drive_along(
            road,
            from_m=float(rng.uniform(-15.0, travelled_m + 40.0)),
            across_m=side * float(rng.uniform(KERB_M + 1.3, FACADE_M - 1.8)),
            speed=[(0.0, walk), (seconds, walk)],
            seconds=seconds,
            backwards=bool(rng.random() < 0.5),
        )
        actors.append(Actor(StreetClass.PEDESTRIAN, drive))
    return actors


def _clear_of(
    drive: Drive, what: StreetClass, others: Sequence[tuple[Drive, StreetClass]], seconds: float
) -> bool:
    """Whether boxes never come within a metre of each other; each is tried in the other's axes."""
    time = np.arange(0.0, seconds, 0.1)
    mine = drive.pose(time)
    length, width, _ = SIZE_M[what]
    for other, other_what in others:
        theirs = other.pose(time)
        other_length, other_width, _ = SIZE_M[other_what]
        turn = mine[:, 2] - theirs[:, 2]
        cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        dx, dy = (mine - theirs)[:, :2].T
        c, s = np.cos(theirs[:, 2]), np.sin(theirs[:, 2])
        along, aside = np.abs(c * dx + s * dy), np.abs(-s * dx + c * dy)
        near_along = along < (other_length + length * cos + width * sin) / 2 + _KEEP_APART_M
        near_aside = aside < (other_width + length * sin + width * cos) / 2 + 0.3 * _KEEP_APART_M
        if bool(np.any(near_along & near_aside)):
            return False
    return True
