"""Watch for new failure modes: groups tracks again when scenes were added, and notes new modes."""

import threading
import time
from collections.abc import Callable
from typing import Final

import structlog

from schemas.errors import CounterpointError
from service.errors import UsageError
from service.store.ledger import Ledger

log = structlog.get_logger(__name__)

LOOK_EVERY_S: Final = 60.0
"""Shortest interval of two groupings, seconds."""

REST: Final = 20.0
"""Rest after a grouping as a multiple of its time, so that it takes 5 % of a core at most."""

END_S: Final = 2.0
"""Time for a grouping that is under way at the end, seconds; a longer one is left."""

_BEGUN: Final = ""
"""Name of the notice by which the ledger knows that modes are watched."""


class ModeWatch:
    """Notes new modes of the ledger within a `with` block, in a thread of its own."""

    def __init__(
        self, ledger: Ledger, *, on_new: Callable[[int], None], every_s: float = LOOK_EVERY_S
    ) -> None:
        """Keep the ledger, what is called with the number of new modes, and the interval."""
        self._ledger, self._on_new, self._every_s = ledger, on_new, every_s
        self._stop, self._seen = threading.Event(), -1
        self._thread = threading.Thread(target=self._watch, name="modes", daemon=True)

    def __enter__(self) -> "ModeWatch":
        """Start to watch."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop; a grouping that is under way is given up."""
        self._stop.set()
        self._thread.join(END_S)

    def look(self) -> int:
        """Group the tracks if scenes were added; return the number of new modes.

        Modes that there are at the very first look are known, and no news.

        Raises:
            UsageError: If scikit-learn is not installed.
        """
        last = self._ledger.last_seq()
        if last == self._seen:
            return 0
        modes = self._ledger.proposals.modes().modes
        rows = {row.mode_id: row.model_dump(mode="json") for row in modes}
        webhooks = self._ledger.webhooks
        if not webhooks.has_noted("known mode"):
            webhooks.note("known mode", {name: {} for name in (_BEGUN, *rows)})
            new = 0
        else:
            new = webhooks.note("mode", rows)
        self._seen = last
        if new:
            self._on_new(new)
            log.warning("new failure modes", modes=new)
        return new

    def _watch(self) -> None:
        while not self._stop.is_set():
            began_s = time.monotonic()
            try:
                self.look()
            except UsageError as error:
                log.warning("new failure modes are not noticed", problem=str(error))
                return
            except CounterpointError as error:
                log.warning("failure modes are looked at later", problem=str(error))
            took_s = time.monotonic() - began_s
            self._stop.wait(max(self._every_s, REST * took_s))
