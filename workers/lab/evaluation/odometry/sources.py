"""Odometries under evaluation by name, and the floors of any odometry."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from schemas.frame import LidarFrame, PosedFrame
from schemas.mining import MiningSettings
from workers.errors import UnknownPartError
from workers.parts.catalogue import names_of
from workers.parts.protocols import Odometry
from workers.parts.registry import build_odometry
from workers.version import files_of

PLAIN_KISS_ICP: Final = "kiss-icp:library"
CONSTANT_VELOCITY: Final = "constant-velocity"
"""Floor made of truth: each frame moves as truth moved the frame before."""

LEARNED: Final = "delora"
"""The odometry of a network."""

FLOORS: Final = (CONSTANT_VELOCITY, PLAIN_KISS_ICP)


class PlainKissIcp:
    """KISS-ICP as its library runs by itself: no health state, no deskewing, voxels of 1 m."""

    version = PLAIN_KISS_ICP

    def __call__(self, frames: Iterable[LidarFrame]) -> Iterator[PosedFrame]:
        """Yield each frame with its pose, in order; the first is the origin."""
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP

        config = KISSConfig()
        config.mapping.voxel_size = 1.0
        config.data.max_range = 100.0
        config.data.deskew = False
        config.registration.max_num_threads = 1
        kiss = KissICP(config)
        for frame in frames:
            kiss.register_frame(frame.points_m[frame.valid_mask].astype(np.float64), np.empty(0))
            yield PosedFrame(frame, np.array(kiss.last_pose, dtype=np.float64))


def odometries_in(weights: str) -> list[str]:
    """Return the odometries of networks whose weights are in a folder; empty: no folder."""
    learned = Path(weights) / f"{LEARNED}.safetensors"
    return [LEARNED] if weights and learned.is_file() else []


def build(name: str, settings: MiningSettings) -> Odometry:
    """Build an odometry by its name.

    Raises:
        UnknownPartError: If it does not exist, with the known names in the message.
    """
    if name == PLAIN_KISS_ICP:
        return PlainKissIcp()
    if name in names_of("odometry"):
        return build_odometry(name, files_of(settings))
    raise UnknownPartError(
        f"no odometry {name!r}; known: {', '.join([*names_of('odometry'), *FLOORS])}"
    )
