"""Pipeline versions that get leases: a version counts only where an operator expects it.

The newest version supersedes the scenes of all others, so a worker that announces one of its own
could replace a whole ranking.
"""

from collections.abc import Callable, Sequence
from threading import Lock
from typing import Final

import structlog

log = structlog.get_logger(__name__)

UNEXPECTED_REST_S: Final = 10.0
"""Time after which a worker of an unexpected version asks again, seconds."""

MOST_SAID: Final = 20
"""Versions that are logged, once each; a rogue worker may announce any number."""


class ExpectedVersions:
    """Decides which pipeline versions get leases; may be called from any thread."""

    def __init__(
        self,
        expected: Sequence[str] = (),
        *,
        takes_any: bool,
        known: Callable[[], Sequence[str]] = tuple,
    ) -> None:
        """Keep the rule.

        Args:
            expected: Versions of the setting; if there are any, no other one is taken.
            takes_any: Without expected versions: take every version, as on one machine.
            known: Returns the versions of the ledger; with none, the first that asks is taken.
        """
        self._expected, self._takes_any, self._known = frozenset(expected), takes_any, known
        self._taken: set[str] = set()
        self._said: set[str] = set()
        self._lock = Lock()

    def refusal(self, version: str) -> str:
        """Return in one sentence why a version gets no lease; empty: it gets one."""
        with self._lock:
            if self._is_expected(version):
                return ""
            problem = (
                f"pipeline version {version} is not expected, so its workers get no work: if it is "
                "yours, add it to expected_versions and restart the service"
            )
            if version not in self._said and len(self._said) < MOST_SAID:
                self._said.add(version)
                log.warning(
                    "unexpected pipeline version", pipeline_version=version, problem=problem
                )
            return problem

    def _is_expected(self, version: str) -> bool:
        if self._expected:
            return version in self._expected
        if self._takes_any or version in self._taken:
            return True
        known = set(self._known()) | self._taken
        if version in known or not known:
            self._taken.add(version)
            return True
        return False
