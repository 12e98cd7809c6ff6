"""Demo fleet of `counterpoint demo`: a few short streets with planted failures."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

from workers.lab.simulation.faults.plan import plan_fleet
from workers.lab.simulation.output.fleet import FleetOptions, SimulatedLog, simulate_to

DEMO_SCENES: Final = 30
DEMO_FAILURES: Final = 0.2
DEMO_SEED: Final = 7
DEMO_COLUMNS: Final = 900
"""Columns per revolution, half of the sensors' own, so that the demo takes minutes."""

DEMO_FRAMES: Final = DEMO_SCENES * 20
"""Number of calls of `progress`."""


def make_demo_fleet(
    folder: Path, *, processes: int, progress: Callable[[], None] | None = None
) -> tuple[SimulatedLog, ...]:
    """Write the demo's bucket to `folder/logs` and its truth to `folder/truth`.

    The supervised stream of these logs is `recorded`: the labels of the on-board model, which equal
    the truth except for planted failures.

    Args:
        folder: Folder to create.
        processes: Number of parallel processes; the bytes do not depend on it.
        progress: Called for each frame, as in `simulate_to`.
    """
    plans = plan_fleet(scenes=DEMO_SCENES, seed=DEMO_SEED, share=DEMO_FAILURES)
    options = FleetOptions(columns=DEMO_COLUMNS)
    url = str(folder)
    return tuple(simulate_to(url, plans, options=options, processes=processes, progress=progress))
