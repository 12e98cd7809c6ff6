"""Scene flow sources by name, each a function of two clouds."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from schemas.arrays import Flow, Points, Transform
from workers.points.se3 import transform

SceneFlowSource = Callable[[Points, Points, Transform], Flow]
"""Function from (N, 3) points of this frame, (M, 3) points of the other, each in its own sensor
space, and the ego-motion `other_from_this` as initial estimate. It returns (N, 3) displacement to
the other frame, ego-motion included, metres."""


def nearest_neighbour_flow(
    points_m: Points, other_points_m: Points, other_from_this: Transform
) -> Flow:
    """Return the flow to the nearest point of the other frame, after ego-motion compensation.

    This is the simplest source. It matches overlapping surfaces: a car that moves a metre still has
    neighbours at zero distance on itself, so most of its motion is missed.
    """
    from scipy.spatial import cKDTree

    if len(points_m) == 0 or len(other_points_m) == 0:
        return np.zeros_like(points_m)
    expected = transform(other_from_this, points_m)
    _, nearest = cKDTree(other_points_m).query(expected)
    flow: Flow = other_points_m[nearest] - points_m
    return flow


def registered_clusters_flow(
    points_m: Points, other_points_m: Points, other_from_this: Transform
) -> Flow:
    """Return the flow of rigid clusters, each registered to the other frame."""
    from workers.paper.rigid_flow import rigid_flow

    return rigid_flow(points_m, other_points_m, other_from_this)


SCENE_FLOWS: Final[Mapping[str, SceneFlowSource]] = {
    "nearest-neighbour": nearest_neighbour_flow,
    "registered-clusters": registered_clusters_flow,
}
"""Sources without weights; each is also a stream `two-stage:NAME`."""


class LearnedFlow(Protocol):
    """A source that is a network with its weights."""

    @property
    def version(self) -> str:
        """Return the version of everything but code that changes the output."""
        ...

    def __call__(
        self, points_m: Points, other_points_m: Points, other_from_this: Transform
    ) -> Flow:
        """Estimate flow as a `SceneFlowSource`."""
        ...


def _flowstep3d(folder: Path) -> LearnedFlow:
    from workers.paper.learned_flow import FlowStep3DFlow

    return FlowStep3DFlow.load(folder)


LEARNED_FLOWS: Final[Mapping[str, Callable[[Path], LearnedFlow]]] = {"flowstep3d": _flowstep3d}
"""Sources with weights of the network of the same name; each is a stream `two-stage:NAME`."""


def scene_flow_source(name: str) -> SceneFlowSource:
    """Find the source of this name.

    Raises:
        LookupError: If there is none; the message lists those that exist.
    """
    try:
        return SCENE_FLOWS[name]
    except KeyError:
        known = ", ".join(sorted(SCENE_FLOWS))
        raise LookupError(f"no scene flow {name!r}; known: {known}") from None
