"""Training samples: frames of many short random streets, from memory."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from workers.lab.simulation.sensor.lidar import Lidar, SimulatedFrame, sweep
from workers.lab.simulation.sensor.sensors import MountingName, SensorName, mounted
from workers.lab.simulation.world.street import Street
from workers.lab.simulation.world.street_builder import build_street
from workers.lab.simulation.world.street_plan import draw_plan

MOUNTINGS: Final[tuple[MountingName, ...]] = ("roof", "mast")
DEFAULT_SENSORS: Final[tuple[SensorName, ...]] = ("pandar64", "hdl64", "hdl32", "vlp32c", "os1-128")


@dataclass(frozen=True, slots=True, eq=False)
class StreetSample:
    """Some consecutive frames of one street.

    Attributes:
        street: Street with its traffic.
        lidar: Lidar of the frames.
        frames: In order, one period apart.
    """

    street: Street
    lidar: Lidar
    frames: tuple[SimulatedFrame, ...]


def street_samples(
    seed: int,
    *,
    streets: int,
    windows: int = 2,
    frames: int = 4,
    sensors: Sequence[SensorName] = DEFAULT_SENSORS,
    hard_share: float = 0.4,
    columns: int | None = None,
) -> Iterator[StreetSample]:
    """Simulate random streets of all kinds and sensors, a few frames of each.

    Streets differ from those of any fleet: their seeds come from another random stream.

    Args:
        seed: Seed of all samples; a sample depends on the seed and its street's number alone.
        streets: Number of streets.
        windows: Samples of each street, spread over 12 s of it.
        frames: Consecutive frames of each sample.
        sensors: Sensors to draw from, with either mounting.
        hard_share: Share of streets that are hard.
        columns: Columns of every lidar; each sensor's own when None.
    """
    seconds = 12.0
    for number in range(streets):
        rng = np.random.default_rng([seed, number, 0x5A3B1E])
        plan = draw_plan(rng, hard=bool(rng.random() < hard_share))
        sensor = sensors[int(rng.integers(len(sensors)))]
        lidar = mounted(sensor, MOUNTINGS[int(rng.integers(2))], columns=columns)
        street = build_street(int(rng.integers(2**62)), seconds=seconds, plan=plan)
        last = round(seconds / lidar.period_s) - frames
        for window in range(windows):
            low, high = window * last // windows, (window + 1) * last // windows
            first = int(rng.integers(low, max(high, low + 1)))
            seen = tuple(sweep(street, lidar, first + k) for k in range(frames))
            yield StreetSample(street, lidar, seen)
