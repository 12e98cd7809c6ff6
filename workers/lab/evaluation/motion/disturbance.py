"""Degradation of a log before evaluation: fewer beams, fewer frames, yaw noise on poses."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from schemas.arrays import Mask
from schemas.frame import LidarFrame, PosedFrame
from workers.lab.evaluation.motion.beam_rows import BeamRows
from workers.lidar.deskew import motion

YAW_NOISE_SEED: Final = 0
"""Seed of the yaw noise, together with the frame number: any frame range has the same noise."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Degradation of a log; none by default.

    Attributes:
        rows: Beams that are kept, out of all beams in order of rising elevation.
        every: Frames whose number this divides are kept.
        yaw_noise_deg: Standard deviation of a rotation of each pose about the sensor's vertical
            axis, degrees, independent between frames.
    """

    rows: slice | None = None
    every: int = 1
    yaw_noise_deg: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class NumberedFrame:
    """A frame with its number and its degradation.

    Attributes:
        number: Number of the frame in the truth.
        whole: The frame with all its recorded points.
        frame: The frame with the beams that are kept.
        kept: (N,) recorded points that are in `frame`; None for all.
    """

    number: int
    whole: LidarFrame
    frame: LidarFrame
    kept: Mask | None = None


def without_beams(frames: Iterable[NumberedFrame], rows: slice | None) -> Iterator[NumberedFrame]:
    """Keep only some of the beams of every frame.

    Raises:
        LogUnusableError: If the log does not identify the beam of a point.
    """
    beams: BeamRows | None = None
    for each in frames:
        if rows is None:
            yield each
            continue
        if beams is None:
            beams = BeamRows.of(each.whole)
        kept = np.isin(beams.rows_of(each.whole), np.arange(len(beams))[rows])
        yield replace(each, frame=each.whole.part(kept), kept=kept)


def with_yaw_noise(
    posed: Iterable[PosedFrame], numbers: Iterable[int], noise_deg: float
) -> Iterator[PosedFrame]:
    """Rotate every pose about the sensor's vertical axis by Gaussian noise.

    Args:
        posed: Frames with their poses.
        numbers: A number for each of them that seeds its noise.
        noise_deg: Standard deviation, degrees; 0 leaves poses unchanged.
    """
    for each, number in zip(posed, numbers, strict=True):
        if noise_deg == 0.0:
            yield each
            continue
        random = np.random.default_rng((YAW_NOISE_SEED, number))
        yaw_rad = np.radians(noise_deg) * random.standard_normal()
        turn = motion(np.array([0.0, 0.0, yaw_rad, 0.0, 0.0, 0.0]))
        yield replace(each, odom_from_sensor=each.odom_from_sensor @ turn)
