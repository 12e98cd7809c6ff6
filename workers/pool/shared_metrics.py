"""The metrics of all workers of a pool: each counts in files of its own, the pool serves the sum.

The files belong to places in the pool, not to processes: a worker that fills a place after another
counts on where that one ended, so that weeks of restarts leave as many files as there are places.
"""

import os
from pathlib import Path
from typing import Final

from prometheus_client import CollectorRegistry, values
from prometheus_client.multiprocess import MultiProcessCollector

from schemas.errors import TransientError
from workers.metrics import PoolMetrics

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
        registry: Sums over the workers, and the pool's own metrics.
        pool: The pool's own metrics.
    """

    def __init__(self, folder: Path, *, places: int) -> None:
        """Make the files.

        Args:
            folder: An empty folder that lives as long as the pool.
            places: Workers at a time.

        Raises:
            TransientError: If there is no room for the files.
        """
        self._folder = folder
        try:
            for place in range(places):
                for kind in _KINDS:
                    self._file(kind, place).write_bytes(bytes(FILE_BYTES))
        except OSError as error:
            raise TransientError(
                f"no room for the metrics of {places} workers: {error.strerror or error}; free "
                f"some disk, or set TMPDIR to another folder ({folder})"
            ) from None
        self.registry = CollectorRegistry()
        self.pool = PoolMetrics(self.registry)
        MultiProcessCollector(self.registry, path=str(folder))  # type: ignore[no-untyped-call]

    def forget_gauges(self, place: int) -> None:
        """Take a dead worker's gauges away: it is neither busy nor waiting. Its counts remain."""
        for kind in _KINDS:
            if kind.startswith("gauge"):
                with self._file(kind, place).open("r+b") as file:
                    file.write(_NOTHING)

    def _file(self, kind: str, place: int) -> Path:
        return self._folder / f"{kind}_{place}.db"


def count_in(folder: Path, place: int) -> None:
    """Let every metric that this process makes from now on live in the files of a place.

    Args:
        folder: Where `SharedMetrics` made them.
        place: Number of the place; no two processes may have one at the same time.
    """
    # The library takes the folder from nowhere else.
    os.environ["PROMETHEUS_MULTIPROC_DIR"] = str(folder)  # noqa: TID251
    values.ValueClass = values.MultiProcessValue(lambda: place)  # type: ignore[no-untyped-call]
