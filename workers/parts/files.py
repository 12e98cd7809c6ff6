"""What parts read in addition to the files of the package."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PartFiles:
    """What parts read in addition to the files of the package.

    Attributes:
        model: Adapter of the user's own model; empty: none.
        weights: Folder of imported weights; empty: what ships.
    """

    model: str = ""
    weights: str = ""
