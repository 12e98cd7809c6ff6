"""What a log is made worse by before it is judged: fewer beams, fewer frames, noise of the pose."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from schemas.arrays import Mask
from schemas.frame import LidarFrame, PosedFrame
from workers.lab.evaluation.motion.beam_rows import BeamRows
from workers.lidar.deskew import motion

YAW_NOISE_SEED: Final = 0
"""With the number of the frame, so that noise is the same whichever frames are judged."""


@dataclass(frozen=True, slots=True)
class Disturbance:
    """How a log is disturbed; not at all by default.

    Attributes:
        rows: Which beams are kept, of all beams in the order of rising elevation.
        every: One frame in so many is kept, those whose number it divides.
        yaw_noise_deg: Standard deviation of a turn of each pose about the sensor's vertical axis,
            independent from frame to frame.
    """

    rows: slice | None = None
    every: int = 1
    yaw_noise_deg: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Numbered:
    """A frame as the streams see it.

    Attributes:
        number: Of the frame in the truth.
        whole: As it was recorded.
        frame: With the beams that are kept.
        kept: (N,) which of the recorded points are in `frame`; None for all.
    """

    number: int
    whole: LidarFrame
    frame: LidarFrame
    kept: Mask | None = None


def without_beams(frames: Iterable[Numbered], rows: slice | None) -> Iterator[Numbered]:
    """Keep only some of the beams of every frame.

    Raises:
        LogUnusableError: If the log does not tell which beam measured a point.
    """
    beams: BeamRows | None = None
    for each in frames:
        if rows is None:
            yield each
            continue
        if beams is None:
            beams = BeamRows.of(each.whole)
        kept = np.isin(beams.rows_of(each.whole), np.arange(len(beams))[rows])
        yield replace(each, frame=_only(each.whole, kept), kept=kept)


def with_yaw_noise(
    posed: Iterable[PosedFrame], numbers: Iterable[int], noise_deg: float
) -> Iterator[PosedFrame]:
    """Turn every pose a little about the sensor's vertical axis.

    Args:
        posed: Frames with their poses.
        numbers: A number for each of them, which its noise is drawn by.
        noise_deg: Standard deviation; 0 leaves poses as they are.
    """
    for each, number in zip(posed, numbers, strict=True):
        if noise_deg == 0.0:
            yield each
            continue
        random = np.random.default_rng((YAW_NOISE_SEED, number))
        yaw_rad = np.radians(noise_deg) * random.standard_normal()
        turn = motion(np.array([0.0, 0.0, yaw_rad, 0.0, 0.0, 0.0]))
        yield replace(each, odom_from_sensor=each.odom_from_sensor @ turn)


def _only(frame: LidarFrame, kept: Mask) -> LidarFrame:
    recorded = frame.recorded
    if recorded is not None:
        motion, confidence = recorded.motion, recorded.confidence
        recorded = replace(
            recorded,
            class_id=recorded.class_id[kept],
            motion=None if motion is None else motion[kept],
            confidence=None if confidence is None else confidence[kept],
        )
    return replace(
        frame,
        points_m=frame.points_m[kept],
        intensity=frame.intensity[kept],
        offset_ns=frame.offset_ns[kept],
        ring=frame.ring[kept],
        valid_mask=frame.valid_mask[kept],
        recorded=recorded,
    )
