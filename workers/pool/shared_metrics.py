"""The metrics of all workers of a pool: each counts in files of its own, the pool serves the sum.

The files belong to places in the pool, not to processes: a worker that fills a place after another
counts on where that one ended, so that weeks of restarts leave as many files as there are places.
Whatever becomes of the files, mining goes on: what cannot be counted is said once.
"""

import os
from pathlib import Path
from typing import Final

import structlog
from prometheus_client import CollectorRegistry, values
from prometheus_client.multiprocess import MultiProcessCollector

from schemas.errors import TransientError
from workers.pool.metrics_folder import MetricsFolder
from workers.worker.metrics import PoolMetrics

log = structlog.get_logger(__name__)

FILE_BYTES: Final = 128 * 1024
"""Several times what a worker's metrics take, and really there: a disk that fills up later would
end whoever writes to a mapped file without room for it."""

_KINDS: Final = ("counter", "histogram", "gauge_livesum", "gauge_livemax")
"""First part of the names that `prometheus_client` gives its files, for the metrics there are."""

_NOTHING: Final = bytes(8)
"""At the start of such a file: nothing is in it."""


class SharedMetrics:
    """What a pool knows of its workers' metrics, and its own.

    Attributes:
        folder: Where the workers count.
        registry: Sums over the workers, and the pool's own metrics.
        pool: The pool's own metrics.
    """

    def __init__(self, home: Path, *, places: int) -> None:
        """Make the files.

        Args:
            home: Where the folder of the files shall lie: a local disk that nobody cleans.
            places: Workers at a time.

        Raises:
            TransientError: If there is no room for the files.
        """
        self._folder, self._places = MetricsFolder(home), places
        self.folder = self._folder.path
        try:
            self._make_missing()
        except OSError as error:
            self.remove()
            raise TransientError(
                f"no place for the metrics of {places} workers: {error.strerror or error} "
                f"({self.folder}); mend its permissions or free some disk, or name another place: "
                "--state for `run`, NUMBA_CACHE_DIR for `worker`"
            ) from None
        self.registry = CollectorRegistry()
        self.pool = PoolMetrics(self.registry)
        MultiProcessCollector(self.registry, path=str(self.folder))  # type: ignore[no-untyped-call]
        self._in_trouble = False

    def mend(self) -> None:
        """Make again what somebody has taken away, and say so.

        A worker that is at work counts on in files that no longer have a name: what it counts is
        missing from the sum until another takes its place.
        """
        try:
            made = self._make_missing()
        except OSError as error:
            self._say_trouble(error)
        else:
            if made:
                log.warning(
                    "metrics of the workers were removed by somebody, and their files made again",
                    folder=str(self.folder),
                    files=made,
                )
            self._in_trouble = False

    def forget_gauges(self, place: int) -> None:
        """Take a dead worker's gauges away: it is neither busy nor waiting. Its counts remain."""
        self.mend()
        try:
            for kind in _KINDS:
                if kind.startswith("gauge"):
                    with self._file(kind, place).open("r+b") as file:
                        file.write(_NOTHING)
        except OSError as error:
            self._say_trouble(error)

    def remove(self) -> None:
        """Take the files away: no worker is left to count."""
        self._folder.remove()

    def _make_missing(self) -> int:
        """Make the files that are not there; return how many."""
        self._folder.hold()
        made = 0
        for place in range(self._places):
            for kind in _KINDS:
                file = self._file(kind, place)
                if not file.exists():
                    _make(file)
                    made += 1
        return made

    def _say_trouble(self, error: OSError) -> None:
        if not self._in_trouble:
            log.warning(
                "metrics of the workers cannot be kept; mining goes on without them",
                folder=str(self.folder),
                problem=error.strerror or str(error),
            )
        self._in_trouble = True

    def _file(self, kind: str, place: int) -> Path:
        return self.folder / f"{kind}_{place}.db"


def count_in(folder: Path, place: int) -> None:
    """Let every metric that this process makes from now on live in the files of a place.

    Where they cannot be written the process counts for itself alone, and says so.

    Args:
        folder: Where `SharedMetrics` made them.
        place: Number of the place; no two processes may have one at the same time.
    """
    if not os.access(folder, os.W_OK):  # somebody took it away, or its disk went read-only
        log.warning("what this worker counts is not served", folder=str(folder), place=place)
        return
    # The library takes the folder from nowhere else.
    os.environ["PROMETHEUS_MULTIPROC_DIR"] = str(folder)  # noqa: TID251
    values.ValueClass = values.MultiProcessValue(lambda: place)  # type: ignore[no-untyped-call]


def _make(file: Path) -> None:
    """Make a file that is there as a whole or not at all: it may be read at any moment."""
    fresh = file.with_suffix(".new")
    try:
        fresh.write_bytes(bytes(FILE_BYTES))
        fresh.rename(file)
    except OSError:
        fresh.unlink(missing_ok=True)
        raise
