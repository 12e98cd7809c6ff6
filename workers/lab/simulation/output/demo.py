"""The fleet of `counterpoint demo`: a few short streets whose car's model was made to err."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from workers.lab.simulation.faults.plan import plan_fleet
from workers.lab.simulation.output.fleet import FleetOptions, SimulatedLog, simulate_to

DEMO_SCENES: Final = 30
DEMO_FAILURES: Final = 0.2
DEMO_SEED: Final = 7
DEMO_COLUMNS: Final = 900
"""Half of what the sensors fire: the demo has to be over in minutes."""

DEMO_FRAMES: Final = DEMO_SCENES * 20
"""How often `progress` is called."""


def make_demo_fleet(
    folder: Path, *, processes: int, progress: Callable[[], None] | None = None
) -> tuple[SimulatedLog, ...]:
    """Write the demo's bucket to `folder/logs` and its truth to `folder/truth`.

    The supervised voice of these logs is `recorded`: the labels of the model that ran on the car,
    which are the truth but for what was planted.

    Args:
        folder: Is made.
        processes: How many write at once; the bytes are the same.
        progress: Called for each frame, as `simulate_to` does.
    """
    plans = plan_fleet(scenes=DEMO_SCENES, seed=DEMO_SEED, share=DEMO_FAILURES)
    options = FleetOptions(columns=DEMO_COLUMNS)
    url = str(folder)
    return tuple(simulate_to(url, plans, options=options, processes=processes, progress=progress))
