"""Compiles the loops of the stream in a process of its own: the compiler's memory goes with it.

What the compiler leaves behind in a process is half as much again as the stream needs. A child
compiles, on a small street, and leaves the loops in numba's cache on disk; whoever labels loads
them from there.
"""

import fcntl
import hashlib
import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Final

import structlog

from workers.sources import source_digest
from workers.visibility.compiled import COMPILED, cache_folder
from workers.visibility.passes import within

log = structlog.get_logger(__name__)

_CHILD_S: Final = 3600.0
"""Fifteen to thirty seconds on a quiet core, ten minutes were seen on one shared by fourteen."""


def compile_apart() -> None:
    """See to it that the loops of the default stream are compiled, once for a machine.

    Of several processes that begin at once, one compiles and the others wait for it. Where the
    cache cannot be written, or the child fails, that is said, and this process compiles by itself.
    """
    folder = cache_folder(within)
    if folder is None:
        return  # said where the loops were made
    marker = Path(folder) / _marker()
    if marker.exists():
        return
    try:
        with _alone(marker.with_suffix(".lock")):
            if not marker.exists():
                log.info("compiling loops, once for this version", folder=folder)
                _in_child()
                marker.touch()
    except (OSError, subprocess.SubprocessError) as error:
        log.warning(
            "loops could not be compiled apart: this process compiles them, and needs more memory",
            folder=folder,
            problem=str(error),
        )


def rehearse() -> None:
    """Run the default odometry and stream on a small street, so that every loop is called.

    Loops that other stages share with them are called beside.
    """
    from workers.geometry.rehearsal import call_loops
    from workers.selfsupervised.odometry import KissOdometry
    from workers.selfsupervised.rehearsal import rehearsal
    from workers.selfsupervised.stream import Registration

    for with_beams in (True, False):
        deque(Registration()(KissOdometry()(rehearsal(with_beams=with_beams))), maxlen=0)
    call_loops(next(rehearsal(with_beams=True)))


def _marker() -> str:
    """Name all that compiled code hangs on: sources, compiler, processor."""
    from numba.core.registry import cpu_target

    processor = repr(cpu_target.target_context.codegen().magic_tuple())
    said = f"{source_digest(*COMPILED)} {metadata.version('numba')} {sys.version} {processor}"
    return f"loops-{hashlib.sha256(said.encode()).hexdigest()[:16]}.compiled"


def _in_child() -> None:
    subprocess.run(
        [sys.executable, "-m", "workers.selfsupervised.compiling"],
        check=True,
        capture_output=True,
        timeout=_CHILD_S,
    )


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Hold a lock between processes; it ends with its holder, however that ends."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


if __name__ == "__main__":
    rehearse()
