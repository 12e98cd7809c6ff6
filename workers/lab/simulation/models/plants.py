"""Models of trees, bushes and hedges: small leaves on branches, through which beams pass."""

from functools import cache
from typing import Final

import numpy as np

from workers.lab.simulation.models.kinds import Material, StreetClass
from workers.lab.simulation.models.meshes import Mesh, leaves, limb

SORTS: Final = 6
"""Number of different shapes of trees and bushes; placement also varies size and rotation."""

_LEAVES_OF_TREE: Final = 480
_LEAVES_OF_BUSH: Final = 150


@cache
def tree(sort: int) -> Mesh:
    """Build a tree 7 m high, or a conifer; the origin is at its foot."""
    rng = np.random.default_rng([sort, 0x72EE])
    trunk, green = StreetClass.TRUNK, StreetClass.VEGETATION
    if sort % SORTS == SORTS - 1:
        up = rng.uniform(0.0, 1.0, _LEAVES_OF_TREE) ** 1.4
        out = 1.7 * (1.05 - up) * rng.uniform(0.5, 1.0, _LEAVES_OF_TREE)
        turn = rng.uniform(0.0, 2 * np.pi, _LEAVES_OF_TREE)
        places = np.stack([out * np.cos(turn), out * np.sin(turn), 0.6 + 6.4 * up], axis=1)
        stem = limb(
            (0.0, 0.0, -0.3), (0.0, 0.0, 6.0), 0.16, 0.04, what=trunk, material=Material.BARK
        )
        return Mesh.merged([stem, leaves(places, 0.38, rng, what=green)])
    fork_m = float(rng.uniform(1.9, 2.8))
    parts = [
        limb(
            *((0.0, 0.0, -0.3), (0.0, 0.0, fork_m), 0.19, 0.14), what=trunk, material=Material.BARK
        )
    ]
    centres = []
    for _ in range(6):
        way, reach = float(rng.uniform(0.0, 2 * np.pi)), float(rng.uniform(0.5, 1.7))
        tip = np.array([reach * np.cos(way), reach * np.sin(way), rng.uniform(fork_m + 1.0, 6.0)])
        centres.append(tip)
        parts.append(
            limb(
                *((0.0, 0.0, fork_m - 0.1), tip, 0.09, 0.03),
                what=trunk,
                material=Material.BARK,
                sides=5,
            )
        )
    chosen = np.array(centres)[rng.integers(0, len(centres), _LEAVES_OF_TREE)]
    spread = rng.normal(0.0, 1.0, (_LEAVES_OF_TREE, 3))
    spread *= (rng.uniform(0.55, 1.0, _LEAVES_OF_TREE) / np.linalg.norm(spread, axis=1))[:, None]
    places = chosen + spread * np.array([1.25, 1.25, 1.0])
    places[:, 2] = np.maximum(places[:, 2], fork_m - 0.2)
    return Mesh.merged([*parts, leaves(places, 0.34, rng, what=green)])


@cache
def bush(sort: int) -> Mesh:
    """Build a bush about 1.4 m high and 1.6 m wide."""
    rng = np.random.default_rng([sort, 0xB054])
    spread = rng.normal(0.0, 1.0, (_LEAVES_OF_BUSH, 3))
    spread *= (rng.uniform(0.5, 1.0, _LEAVES_OF_BUSH) / np.linalg.norm(spread, axis=1))[:, None]
    places = spread * np.array([0.8, 0.8, 0.7]) + np.array([0.0, 0.0, 0.65])
    places[:, 2] = np.abs(places[:, 2])
    return leaves(places, 0.28, rng, what=StreetClass.VEGETATION)


@cache
def hedge(sort: int) -> Mesh:
    """Build two metres of a clipped hedge along x, 0.7 m thick and 1.3 m high."""
    rng = np.random.default_rng([sort, 0x4ED6])
    n = 200
    places = rng.uniform([-1.05, -0.35, 0.0], [1.05, 0.35, 1.3], (n, 3))
    face = rng.integers(0, 3, n)
    places[face == 0, 1] = rng.choice([-0.35, 0.35], int((face == 0).sum()))
    places[face == 1, 2] = 1.3
    return leaves(places, 0.26, rng, what=StreetClass.VEGETATION)


@cache
def grass(sort: int) -> Mesh:
    """Build tufts of grass over a few square metres."""
    rng = np.random.default_rng([sort, 0x66A5])
    places = rng.uniform([-2.0, -1.0, 0.0], [2.0, 1.0, 0.25], (70, 3))
    return leaves(places, 0.16, rng, what=StreetClass.VEGETATION)
