"""The fleet of `counterpoint demo`: a few short streets whose car's model was made to err."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from workers.simulation.fleet import SimulatedLog, simulate_fleet

DEMO_LOGS: Final = 5
DEMO_SECONDS: Final = 12.0
DEMO_SEED: Final = 7
DEMO_FRAMES: Final = DEMO_LOGS * int(DEMO_SECONDS * 10)
"""How often `progress` is called."""


def make_demo_fleet(
    folder: Path, progress: Callable[[], None] | None = None
) -> tuple[SimulatedLog, ...]:
    """Write the demo's bucket to `folder/logs` and its truth to `folder/truth`.

    The supervised voice of these logs is `recorded`: the labels of the model that ran on the car,
    which are the truth but for a missed car, a parked car called moving and an unseen pedestrian.
    One log is without mistakes.
    """
    return tuple(
        simulate_fleet(
            folder, logs=DEMO_LOGS, seconds=DEMO_SECONDS, seed=DEMO_SEED, progress=progress
        )
    )
