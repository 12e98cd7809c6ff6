"""Array types that the stages exchange, and the check of their shape and element type."""

from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

Points = NDArray[np.float32]
"""(N, 3) positions in metres, in the space that the name or the docstring gives."""

Flow = NDArray[np.float32]
"""(N, 3) displacements in metres."""

Mask = NDArray[np.bool_]
"""(N,) boolean mask; true where the condition in its name is met."""

Transform = NDArray[np.float64]
"""(4, 4) rigid transform, named `to_from_from`: it maps points of the second space to the first."""

Labels = NDArray[np.uint8]
"""(N,) indices into the classes of a `schemas.task.Task`, or its `unknown`."""

MotionLabels = Labels
"""(N,) values of `schemas.labels.MotionLabel`: labels of the task `MOTION`."""

Agreements = NDArray[np.uint8]
"""(N,) codes of the outcomes of a `schemas.task.Task`."""

Confidences = NDArray[np.float16]
"""(N,) confidence of a stream in its label, 0 to 1; half precision, since every point has one."""

NS_PER_S: Final = 1_000_000_000


def check_array(
    name: str, array: NDArray[Any], *, shape: tuple[int | None, ...], dtype: DTypeLike
) -> None:
    """Check the shape and the element type of an array.

    Args:
        name: Name of the array in the error message.
        array: The array to check.
        shape: Expected lengths; None allows any.
        dtype: Expected type of the elements.

    Raises:
        ValueError: If shape or type differ; the message gives both.
    """
    fits = len(shape) == array.ndim and all(
        expected is None or expected == actual
        for expected, actual in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype != np.dtype(dtype):
        raise ValueError(
            f"{name} must be {_describe(shape)} {np.dtype(dtype)}, "
            f"got {_describe(array.shape)} {array.dtype}"
        )


def freeze(*arrays: NDArray[Any] | None) -> None:
    """Make arrays read-only, so that no stage can move a point."""
    for array in arrays:
        if array is not None:
            array.flags.writeable = False


def _describe(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("N" if length is None else str(length) for length in shape) + ")"
