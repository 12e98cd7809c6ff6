"""Streets of the loop: those of the first model, the fleet that it mines, and the held-out ones."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from schemas.arrays import NS_PER_S
from workers.lab.simulation.models.kinds import StreetClass
from workers.lab.simulation.output.write import Identity, write_log
from workers.lab.simulation.sensor.lidar import Lidar
from workers.lab.simulation.sensor.sensors import mounted
from workers.lab.simulation.world.street import Street
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.street_plan import draw_plan

UNKNOWN: Final = (StreetClass.TRUCK, StreetClass.BUS)
"""Road users that the first model never saw."""

RAIN_SHARE: Final = 0.03
"""Share of beams returned by drops in the weather that the first model never saw."""

LOG_S: Final = 4.0
"""Length of a log of the fleet, seconds: two scenes."""

_HARD_SHARE: Final = 0.4
_START_NS: Final = 1_772_445_600 * NS_PER_S
_DAY_NS: Final = 86_400 * NS_PER_S


@dataclass(frozen=True, slots=True)
class World:
    """Frequencies of what the first model never saw; each street draws them independently.

    Attributes:
        unknown: Share of the streets with the road users `UNKNOWN`.
        rain: Share of the streets with rain.
        stream: Number of its random stream, so that no two worlds share a street.
    """

    unknown: float
    rain: float
    stream: int


TAUGHT: Final = World(unknown=0.0, rain=0.0, stream=1)
FLEET: Final = World(unknown=0.25, rain=0.25, stream=2)
HELD_OUT: Final = World(unknown=0.5, rain=0.5, stream=3)


@dataclass(frozen=True, slots=True, eq=False)
class DrawnStreet:
    """A street of a world.

    Attributes:
        street: The street.
        unknown: Whether the road users `UNKNOWN` may be on it.
        rain: Whether it rains.
    """

    street: Street
    unknown: bool
    rain: bool


def loop_lidar() -> Lidar:
    """Return the lidar of every car of the loop: 32 beams, 600 firings per turn."""
    return mounted("hdl32", "roof", columns=600)


def draw_street(world: World, number: int, *, seed: int, seconds: float) -> DrawnStreet:
    """Draw a street of a world; it depends on the arguments alone."""
    rng = np.random.default_rng([seed, number, world.stream, 0x100B])
    unknown, rain = bool(rng.random() < world.unknown), bool(rng.random() < world.rain)
    plan = replace(
        draw_plan(rng, hard=bool(rng.random() < _HARD_SHARE)),
        rain_share=RAIN_SHARE if rain else 0.0,
        dust=False,
        without=() if unknown else UNKNOWN,
    )
    street = build_street(int(rng.integers(2**62)), seconds=seconds, plan=plan)
    return DrawnStreet(street, unknown, rain)


def write_fleet_log(folder: Path, number: int, *, seed: int) -> None:
    """Write one log of the fleet to `folder/logs` and its truth to `folder/truth`.

    A log that is there is kept, so that a killed run writes only what is missing.
    """
    key = f"sim-{number % 5 + 1:02d}/2026-03-02/loop-{number:03d}"
    log, truth = folder / "logs" / f"{key}.mcap", folder / "truth" / key
    if log.is_file() and (truth / "tracks.csv").is_file():
        return
    drawn = draw_street(FLEET, number, seed=seed, seconds=LOG_S)
    write_log(
        log,
        drawn.street,
        lidar=loop_lidar(),
        identity=Identity(vehicle=key.partition("/")[0], start_ns=_START_NS + number * _DAY_NS),
        recorded="nothing",
        truth=truth,
        log_key=f"logs/{key}.mcap",
    )
