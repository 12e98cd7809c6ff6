"""Files of the user that parts read."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PartFiles:
    """Files that parts read in addition to those of the package.

    Attributes:
        model: Adapter of the user's own model; empty: none.
        weights: Folder of imported weights; empty: those that ship.
        motion_rule: Thresholds of the two-stage rule, as JSON; empty: the published ones.
        device: Device of the networks over range images: auto, cpu or cuda.
    """

    model: str = ""
    weights: str = ""
    motion_rule: str = ""
    device: str = "auto"
