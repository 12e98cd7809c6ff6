"""Compiled kernels: the one place with numba's options."""

from collections.abc import Callable
from functools import cache
from typing import Any, Final, TypeVar, cast

import structlog
from numba import njit

from workers.sources import source_digest

COMPILED: Final = (
    "workers.contradiction",
    "workers.free_space",
    "workers.lidar",
    "workers.odometry",
    "workers.paper",
    "workers.points",
    "workers.selfsupervised",
    "workers.witness",
)
"""Packages with compiled loops."""

log = structlog.get_logger(__name__)

Loop = TypeVar("Loop", bound=Callable[..., Any])


def compiled(loop: Loop) -> Loop:
    """Compile a loop over arrays at its first call, and cache the result on disk.

    One thread and no reordering of sums: the same input gives the same bits. The interpreter lock
    is released while a loop runs, so that a lease can be renewed meanwhile.

    The cache of numba notices changes of a function's own file only, not of the loops and numbers
    that it takes from others; a digest of all of them in the name makes stale code impossible.
    Where no cache can be written, one warning is logged, and every process compiles for itself.
    """
    return _compiled(loop, inline=False)


def inlined(loop: Loop) -> Loop:
    """Compile a loop that others call for each point, inlined into its callers.

    A call passes an array as several words, which takes as long as a short loop.
    """
    return _compiled(loop, inline=True)


def _compiled(loop: Loop, *, inline: bool) -> Loop:
    loop.__qualname__ += f"_{source_digest(*COMPILED)[:8]}"
    compiler = njit(nogil=True, error_model="numpy", forceinline=inline)
    dispatcher = compiler(loop)
    try:
        dispatcher.enable_caching()
    except RuntimeError:  # numba's word for a cache that cannot be written anywhere
        _warn_uncached()
    return cast(Loop, dispatcher)


def cache_folder(loop: Callable[..., Any]) -> str | None:
    """Return the folder of a compiled loop's cache; None where there is none."""
    return cast(str | None, cast(Any, loop).stats.cache_path)


@cache
def _warn_uncached() -> None:
    log.warning(
        "no cache for compiled loops: every process compiles them again, in time and memory",
        remedy="set NUMBA_CACHE_DIR to a writable folder",
    )
