"""Options of reading a data set."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Choice of what is read of a data set.

    Attributes:
        with_cameras: Whether images are read; of several cameras, the one that looks ahead.
        between_keyframes: Whether boxes are interpolated between annotated frames.
    """

    with_cameras: bool = True
    between_keyframes: bool = True
