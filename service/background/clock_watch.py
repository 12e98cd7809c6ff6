"""Notices when the clock of this machine is set: terms of leases, ages and rates count by it."""

import time
from collections.abc import Callable
from typing import Final

import structlog

log = structlog.get_logger(__name__)

STEP_S: Final = 2.0
"""A clock that is kept right moves by far less between two looks."""

GLANCE_S: Final = 0.1
"""A look at both clocks that took longer compares two different moments."""


class ClockWatch:
    """Compares the clock of the world with one that nobody can set.

    Attributes:
        steps: Times that it was set `forward` and `back`; a machine that was suspended counts too.
    """

    def __init__(
        self,
        *,
        now_s: Callable[[], float] = lambda: time.clock_gettime(time.CLOCK_REALTIME),
        steady_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin to compare.

        Args:
            now_s: Seconds since the Unix epoch.
            steady_s: Seconds that never step.
        """
        self._now_s, self._steady_s = now_s, steady_s
        self.steps = {"forward": 0, "back": 0}
        self._offset_s: float | None = None

    def look(self) -> None:
        """Say so if the clock was set since the last look."""
        began_s = self._steady_s()
        offset_s = self._now_s() - began_s
        if self._steady_s() - began_s > GLANCE_S:
            return
        before_s, self._offset_s = self._offset_s, offset_s
        if before_s is None:
            return
        step_s = offset_s - before_s
        if abs(step_s) >= STEP_S:
            self.steps["forward" if step_s > 0 else "back"] += 1
            log.warning(
                "the clock was set: leases and waits are cut to their terms, nothing is lost",
                step_s=round(step_s, 1),
            )
