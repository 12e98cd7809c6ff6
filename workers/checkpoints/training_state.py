"""What known training scripts store beside the parameters, and the inert things put in its place.

The scripts of SalsaNext and LiDAR-MOS pickle their learning rate schedule as it is: with the
optimiser in it, a cyclic schedule, methods bound to them, and scores as numpy numbers. None of it
is needed, and none of it is built.
"""

from collections.abc import Callable
from typing import Any, Final


class SetAside:
    """Stands for an object that is not built."""

    def __init__(self, *_: object) -> None:
        """Take whatever the object would have been made of."""

    def __setstate__(self, state: object) -> None:
        """Take whatever it would have held."""


def _empty(*_: object) -> dict[Any, Any]:
    """Stand for a dict with a factory: what it held is put into a plain one."""
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
"""A bound method is pickled as `getattr(object, name)`; what stands for it looks nothing up."""

STAND_INS: Final[tuple[tuple[Callable[..., object], str], ...]] = (
    *((SetAside, name) for name in _CLASSES),
    *(
        (SetAside, f"{module}.{name}")
        for module in ("builtins", "__builtin__")
        for name in _BUILTINS
    ),
    (_empty, "collections.defaultdict"),
)
"""Each with the name it stands for; everything else is refused."""
