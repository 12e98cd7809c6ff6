"""Files of frames to learn from, kept in the work folder of a run, and pairs of consecutive ones.

A folder of files appears when it is complete, so that a killed run builds only what is missing.
"""

import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final, Protocol

from schemas.arrays import NS_PER_S
from schemas.frame import LidarFrame, PosedFrame
from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from workers.ingest.read import read_shard
from workers.lab.datasets.images import Cloud
from workers.lab.datasets.learnt_clouds import Stretch
from workers.lab.datasets.simulated import clouds_of
from workers.lab.simulation.output.samples import street_samples
from workers.lab.simulation.sensor.sensors import SensorName

LONGEST_STEP_S: Final = 0.5
"""Longest time between the frames of a pair, seconds."""

_GAP: Final = 10
"""Numbers from one sample of a street to the next: frames of two samples are no pair."""


class Storable(Protocol):
    """Data kept of one frame."""

    def write(self, path: Path) -> None:
        """Write it to an `.npz` file."""
        ...


Numbered = Iterator[tuple[int, Storable | None]]
"""Number of each frame, and what is kept of it; None: nothing."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Files of two consecutive frames."""

    first: Path
    second: Path


def made_once(folder: Path, build: Callable[[], Numbered]) -> list[Path]:
    """Write a folder of files, or list those of an earlier run, in order of time.

    Args:
        folder: Folder of these files alone.
        build: Makes what is kept of each frame.
    """
    if not folder.is_dir():
        aside = folder.with_name(f".{folder.name}.part")
        shutil.rmtree(aside, ignore_errors=True)
        aside.mkdir(parents=True)
        for number, kept in build():
            if kept is not None:
                kept.write(aside / f"{number:06d}.npz")
        aside.rename(folder)
    return sorted(folder.iterdir())


def pairs_of(paths: Sequence[Path]) -> list[Pair]:
    """Return the pairs of files whose numbers follow each other."""
    return [
        Pair(first, second)
        for first, second in pairwise(paths)
        if int(second.stem) == int(first.stem) + 1
    ]


def stretch_frames(
    bucket: Bucket, stretch: Stretch, settings: MiningSettings
) -> Iterator[LidarFrame]:
    """Yield the frames of a stretch, its warm-up included."""
    return read_shard(bucket, stretch.recording, stretch.shard, settings).frames()


def chosen(
    frames: Iterable[PosedFrame], stretch: Stretch, on_frame: Callable[[], None]
) -> Iterator[tuple[int, PosedFrame]]:
    """Yield the frames of a stretch that are taken; a number is left out where time jumps.

    Args:
        frames: Frames from the warm-up on.
        stretch: The stretch.
        on_frame: Called with each frame taken.
    """
    shard, position, jumps, before_ns = stretch.shard, 0, 0, 0
    for posed in frames:
        stamp_ns = posed.frame.stamp_ns
        if not shard.start_ns <= stamp_ns < shard.end_ns:
            continue
        if position >= stretch.frames.stop:
            return
        if position in stretch.frames:
            on_frame()
            apart_ns = stamp_ns - before_ns
            jumps += bool(before_ns) and not 0 < apart_ns <= LONGEST_STEP_S * NS_PER_S
            before_ns = stamp_ns
            yield position + jumps, posed
        position += 1


def street_clouds(
    *,
    streets: int,
    sensors: Sequence[SensorName],
    seed: int,
    columns: int | None,
    on_window: Callable[[], None],
) -> Iterator[tuple[int, list[Cloud]]]:
    """Yield three consecutive clouds of each sample of simulated streets, and its first number."""
    drawn = street_samples(seed, streets=streets, sensors=sensors, columns=columns)
    for number, sample in enumerate(drawn):
        yield number * _GAP, clouds_of(sample)
        on_window()
