"""How inner loops are compiled: the one place that touches numba's options."""

from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

from numba import njit

from workers.sources import source_digest

COMPILED: Final = (
    "workers.geometry",
    "workers.visibility",
    "workers.selfsupervised",
    "workers.witness",
)
"""Packages with such loops."""

Loop = TypeVar("Loop", bound=Callable[..., Any])


def compiled(loop: Loop) -> Loop:
    """Compile a loop over arrays at its first call, and keep the result on disk.

    One thread and no reordering of sums: the same input gives the same bits. The interpreter lock
    is released while a loop runs, so that a lease can be renewed meanwhile.

    The cache of numba notices changes of a function's own file only, not of the loops and numbers
    that it takes from others; a digest of all of them in the name makes stale code impossible.
    """
    loop.__qualname__ += f"_{source_digest(*COMPILED)[:8]}"
    return cast(Loop, njit(cache=True, nogil=True, error_model="numpy")(loop))
