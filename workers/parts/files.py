"""Files of the user that parts read."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PartFiles:
    """Files that parts read in addition to those of the package.

    Attributes:
        model: Adapter of the user's own model; empty: none.
        weights: Folder of imported weights; empty: those that ship.
    """

    model: str = ""
    weights: str = ""
