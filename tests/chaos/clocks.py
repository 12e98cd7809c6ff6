"""System clocks of the processes: each is wrong by minutes, and is set in mid-run."""

import random
from pathlib import Path
from typing import Final

from tests.integration.steered_clock import SteeredClock, build_clock

AHEAD_S: Final = (-780, -300, -60, -7, 0, 0, 7, 60, 300, 780)
"""Seconds by which a clock may be ahead: less than S3 allows between two machines (15 min)."""

REFUSED_S: Final = (-3600, 3600)
"""Seconds by which a clock is so wrong that an S3 gateway refuses every request."""


class Clocks:
    """A clock for each process, by its name."""

    def __init__(self, folder: Path, *, seed: int) -> None:
        """Build the library that steers them.

        Args:
            folder: For everything.
            seed: Of the clocks at the start.
        """
        folder.mkdir()
        self._folder, self._library = folder, build_clock(folder)
        self._random = random.Random(seed)  # noqa: S311
        self._clocks: dict[str, SteeredClock] = {}

    def variables_of(self, name: str) -> dict[str, str]:
        """Return the variables under which a process has its clock, wrong from the start."""
        if name not in self._clocks:
            self._clocks[name] = SteeredClock(self._folder / name, self._library)
            self.set(name, self._random.choice(AHEAD_S))
        return self._clocks[name].env

    def set(self, name: str, ahead_s: int) -> None:
        """Set the clock of a process, running or not, seconds ahead."""
        self._clocks[name].set(ahead_s)
