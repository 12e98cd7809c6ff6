"""Scene flows under evaluation by name, with the floors of any flow."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from schemas.arrays import Flow, Points, Transform
from workers.errors import UnknownPartError
from workers.paper.rigid_flow import rigid_flow
from workers.paper.scene_flow import SceneFlowSource, nearest_neighbour_flow
from workers.points.se3 import transform


def zero_flow(points_m: Points, other_points_m: Points, other_from_this: Transform) -> Flow:
    """Return no flow at all: nothing moves in sensor space."""
    return np.zeros_like(points_m)


def ego_flow(points_m: Points, other_points_m: Points, other_from_this: Transform) -> Flow:
    """Return the flow of ego-motion alone: nothing moves over the ground."""
    flow: Flow = transform(other_from_this, points_m) - points_m
    return flow


FLOORS: Final[Mapping[str, SceneFlowSource]] = {
    "zero": zero_flow,
    "ego-motion": ego_flow,
    "nearest-neighbour": nearest_neighbour_flow,
    "registered-clusters": rigid_flow,
}
"""Flows without weights, the simplest first."""


def _flowstep3d(weights: str) -> SceneFlowSource:
    from workers.paper.learned_flow import FlowStep3DFlow

    return FlowStep3DFlow.load(Path(weights))


LEARNED: Final[Mapping[str, Callable[[str], SceneFlowSource]]] = {"flowstep3d": _flowstep3d}
"""Flows of networks, whose weights are in a folder."""


def flows_in(weights: str) -> list[str]:
    """Return the flows of networks whose weights are in a folder; empty: no folder."""
    folder = Path(weights)
    return [name for name in LEARNED if weights and (folder / f"{name}.safetensors").is_file()]


def build_flow(name: str, weights: str) -> SceneFlowSource:
    """Build a flow by its name.

    Args:
        name: Of `FLOORS` or `LEARNED`.
        weights: Folder of imported weights.

    Raises:
        UnknownPartError: If it does not exist, with the known names in the message.
        WeightsUnusableError: If the weights are missing.
    """
    if name in FLOORS:
        return FLOORS[name]
    if name in LEARNED:
        return LEARNED[name](weights)
    raise UnknownPartError(f"no flow {name!r}; known: {', '.join([*FLOORS, *LEARNED])}")
