"""Training state in checkpoints of known scripts, and the inert objects that replace it.

The scripts of SalsaNext and LiDAR-MOS pickle their whole learning rate schedule: with the optimiser
in it, a cyclic schedule, methods bound to them, and scores as numpy numbers. None of it is needed,
and none of it is built.
"""

from collections.abc import Callable
from typing import Any, Final


class SetAside:
    """Placeholder of an object that is not built."""

    def __init__(self, *_: object) -> None:
        """Accept the constructor arguments of the object."""

    def __setstate__(self, state: object) -> None:
        """Accept the state of the object."""


def _empty(*_: object) -> dict[Any, Any]:
    """Replace a dict with a factory by a plain dict for its items."""
    return {}


_CLASSES: Final = (
    *(
        f"torch.optim.lr_scheduler.{name}"
        for name in ("CyclicLR", "LambdaLR", "StepLR", "_LRScheduler")
    ),
    *(
        f"torch.optim.lr_scheduler.{name}"
        for name in ("MultiStepLR", "ExponentialLR", "LRScheduler")
    ),
    "torch.optim.sgd.SGD",
    "torch.optim.adam.Adam",
    "common.warmupLR.warmupLR",
    "train.common.warmupLR.warmupLR",
    "numpy.core.multiarray.scalar",
    "numpy.core.multiarray._reconstruct",
    "numpy._core.multiarray.scalar",
    "numpy._core.multiarray._reconstruct",
    "numpy.dtype",
    "numpy.ndarray",
    "_codecs.encode",
    "weakref.WeakMethod",
)
_BUILTINS: Final = ("getattr", "object", "dict", "list")
"""Names in pickled bound methods, `getattr(object, name)`; the replacement looks nothing up."""

STAND_INS: Final[tuple[tuple[Callable[..., object], str], ...]] = (
    *((SetAside, name) for name in _CLASSES),
    *(
        (SetAside, f"{module}.{name}")
        for module in ("builtins", "__builtin__")
        for name in _BUILTINS
    ),
    (_empty, "collections.defaultdict"),
)
"""Replacement and name of each object of the training state; every other name is refused."""
