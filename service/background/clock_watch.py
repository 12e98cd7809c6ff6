"""Detection of steps of the system clock, on which lease terms, ages and rates depend."""

import time
from collections.abc import Callable
from typing import Final

import structlog

log = structlog.get_logger(__name__)

STEP_S: Final = 2.0
"""Smallest change that counts as a step, seconds; disciplined clocks move far less."""

GLANCE_S: Final = 0.1
"""Longest read of both clocks, seconds; beyond it they are of different instants."""


class ClockWatch:
    """Compares the system clock with the monotonic clock.

    Attributes:
        steps: Number of steps `forward` and `back`; a suspended machine counts too.
    """

    def __init__(
        self,
        *,
        now_s: Callable[[], float] = lambda: time.clock_gettime(time.CLOCK_REALTIME),
        steady_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Read both clocks for the first time.

        Args:
            now_s: Seconds since the Unix epoch.
            steady_s: Monotonic seconds.
        """
        self._now_s, self._steady_s = now_s, steady_s
        self.steps = {"forward": 0, "back": 0}
        self._offset_s: float | None = None

    def look(self) -> bool:
        """Log a step of the clock since the last call; return true if there was one."""
        began_s = self._steady_s()
        offset_s = self._now_s() - began_s
        if self._steady_s() - began_s > GLANCE_S:
            return False
        before_s, self._offset_s = self._offset_s, offset_s
        if before_s is None:
            return False
        step_s = offset_s - before_s
        if abs(step_s) < STEP_S:
            return False
        self.steps["forward" if step_s > 0 else "back"] += 1
        log.warning(
            "the clock was set: held leases last a full term from now, nothing is lost",
            step_s=round(step_s, 1),
        )
        return True
