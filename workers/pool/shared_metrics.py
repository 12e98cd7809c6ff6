"""Shared metrics of a pool: each worker counts in its own files, and the pool serves the sum.

The files belong to places in the pool, not to processes. A worker that replaces another continues
its counts, so that weeks of restarts leave as many files as there are places. Mining continues
whatever happens to the files; a failure is logged once.
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
"""Size of a metrics file, bytes: several times what a worker needs. It is allocated in full, since
a full disk would end any process that writes to a sparse mapped file."""

_KINDS: Final = ("counter", "histogram", "gauge_livesum", "gauge_livemax")
"""First part of the file names of `prometheus_client`, by kind of metric."""

_NOTHING: Final = bytes(8)
"""Bytes at the start of an empty file."""


class SharedMetrics:
    """Metrics of a pool's workers, and the pool's own.

    Attributes:
        folder: Folder of the metrics files.
        registry: Sums over the workers, and the pool's own metrics.
        pool: The pool's own metrics.
    """

    def __init__(self, home: Path, *, places: int) -> None:
        """Create the files.

        Args:
            home: Parent of their folder: a local disk that no cleaner empties.
            places: Number of workers at a time.

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
        """Create removed files again, and log it.

        A running worker continues to count in unlinked files: its counts are missing from the sum
        until another worker takes its place.
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
        """Clear a dead worker's gauges: it is neither busy nor waiting. Its counts remain."""
        self.mend()
        try:
            for kind in _KINDS:
                if kind.startswith("gauge"):
                    with self._file(kind, place).open("r+b") as file:
                        file.write(_NOTHING)
        except OSError as error:
            self._say_trouble(error)

    def remove(self) -> None:
        """Remove the files when no worker is left."""
        self._folder.remove()

    def _make_missing(self) -> int:
        """Create the missing files; return their number."""
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
    """Store every metric that this process creates from now on in the files of a place.

    Where they cannot be written, the process counts in its own memory and logs a warning.

    Args:
        folder: Folder of the files that `SharedMetrics` created.
        place: Number of the place; no two processes may have one at the same time.
    """
    if not os.access(folder, os.W_OK):  # it was removed, or its disk became read-only
        log.warning("what this worker counts is not served", folder=str(folder), place=place)
        return
    # The library reads the folder from this variable only.
    os.environ["PROMETHEUS_MULTIPROC_DIR"] = str(folder)  # noqa: TID251
    values.ValueClass = values.MultiProcessValue(lambda: place)  # type: ignore[no-untyped-call]


def _make(file: Path) -> None:
    """Create a file atomically: it may be read at any moment."""
    fresh = file.with_suffix(".new")
    try:
        fresh.write_bytes(bytes(FILE_BYTES))
        fresh.rename(file)
    except OSError:
        fresh.unlink(missing_ok=True)
        raise
