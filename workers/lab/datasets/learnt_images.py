"""Training images of logs and of simulated streets, kept in the work folder of a run.

A folder of images appears when it is complete, so that a killed run builds only what is missing.
"""

import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import TypeAdapter

from schemas.mining import MiningSettings
from schemas.transport.bucket import Bucket
from workers.lab.datasets.images import Cloud, TrainingImages, build_images
from workers.lab.datasets.learnt_clouds import Labeller, Stretch
from workers.lab.datasets.simulated import clouds_of
from workers.lab.datasets.stored_images import join, read_images, write_images
from workers.lab.simulation.output.samples import street_samples
from workers.lab.simulation.sensor.sensors import SensorName
from workers.lidar.range_image import SensorProfile
from workers.lidar.sensor_rows import lay_out
from workers.supervised.residual_image import ResidualSettings

VARIANTS: Final = (1, -1, 2, -2)
"""Residuals of a real log: forwards and backwards, at single and double speed."""

MOST_TOGETHER: Final = 60
"""Frames whose images are built together: 180 MB of clouds, and as much of images."""

_FEWEST: Final = 2
"""Frames of which the second has a past."""

_WINDOWS: Final = 2
_STREET_FRAMES: Final = 10
"""Frames of each window of a street: the first two look ahead, the last two look back."""

_PAST_AND_FUTURE: Final = ((1, range(8, 10)), (-1, range(2)))
_LAYOUT: Final = "layout"
_PROFILE: Final = TypeAdapter(SensorProfile)


@dataclass(frozen=True, slots=True)
class ImageOptions:
    """Layout and residuals of images.

    Attributes:
        profile: Layout, fitted to the first frame of a sensor where it says so.
        residual: Ages of the residual images.
        variants: Directions and speeds in time of the residuals of real logs.
    """

    profile: SensorProfile
    residual: ResidualSettings
    variants: tuple[int, ...] = VARIANTS


@dataclass(frozen=True, slots=True, eq=False)
class LearntImages:
    """Images of one layout, and how they were made.

    Attributes:
        images: The images, memory-mapped.
        layout: Their layout.
        source: Log or sensor.
    """

    images: TrainingImages
    layout: SensorProfile
    source: str

    def __len__(self) -> int:
        """Count the images."""
        return len(self.images.channels)

    def part(self, chosen: slice) -> "LearntImages":
        """Return some of the images."""
        arrays = {
            each.name: getattr(self.images, each.name)[chosen] for each in fields(self.images)
        }
        return replace(self, images=TrainingImages(**arrays))


def images_of_stretch(
    folder: Path,
    bucket: Bucket,
    stretch: Stretch,
    settings: MiningSettings,
    labeller: Labeller,
    *,
    how: ImageOptions,
    seed: int,
    on_frame: Callable[[], None] = lambda: None,
) -> list[LearntImages]:
    """Build the images of a stretch of a log, or read those of an earlier run.

    Args:
        folder: Folder of these images alone.
        bucket: Bucket of the log.
        stretch: The stretch.
        settings: Ingest settings.
        labeller: Source of poses and labels.
        how: Layout and residuals.
        seed: Seed of the pose errors.
        on_frame: Called with each labelled frame.
    """

    def build(aside: Path) -> None:
        rng, layout = np.random.default_rng(seed), None
        clouds = _counted(labeller.clouds(bucket, stretch, settings), on_frame)
        for number, together in enumerate(runs_of(clouds)):
            layout = layout or lay_out(how.profile, together[0].frame)
            images = build_images(together, layout, how.residual, variants=how.variants, rng=rng)
            write_learnt(aside / f"{number:03d}", images, layout, stretch.recording.log_id)

    return read_once(folder, build)


def images_of_streets(
    folder: Path,
    *,
    streets: int,
    sensors: Sequence[SensorName],
    how: ImageOptions,
    seed: int,
    columns: int | None = None,
    on_window: Callable[[], None] = lambda: None,
) -> list[LearntImages]:
    """Build images of simulated streets with their truth, or read those of an earlier run.

    Args:
        folder: Folder of these images alone.
        streets: Number of streets; eight images of each.
        sensors: Sensors to draw from.
        how: Layout and residuals.
        seed: Seed of streets and pose errors.
        columns: Firings per turn of every lidar; None: as the sensor has.
        on_window: Called with each of the two windows of a street.
    """

    def build(aside: Path) -> None:
        made: defaultdict[str, list[TrainingImages]] = defaultdict(list)
        layouts: dict[str, SensorProfile] = {}
        samples = street_samples(
            seed,
            streets=streets,
            windows=_WINDOWS,
            frames=_STREET_FRAMES + 1,
            sensors=sensors,
            columns=columns,
        )
        for number, sample in enumerate(samples):
            clouds = clouds_of(sample)
            sensor, _, _ = sample.lidar.name.partition(" ")
            layout = layouts.setdefault(sensor, lay_out(how.profile, clouds[0].frame))
            rng = np.random.default_rng([seed, number])
            for direction, only in _PAST_AND_FUTURE:
                made[sensor].append(
                    build_images(
                        clouds, layout, how.residual, variants=(direction,), rng=rng, only=only
                    )
                )
            on_window()
        for sensor, parts in sorted(made.items()):
            write_learnt(aside / sensor, join(parts), layouts[sensor], f"streets of {sensor}")

    return read_once(folder, build) if streets else []


def read_once(folder: Path, build: Callable[[Path], None]) -> list[LearntImages]:
    """Read the images of a folder, which is built first if it is missing."""
    if not folder.is_dir():
        aside = folder.with_name(f".{folder.name}.part")
        shutil.rmtree(aside, ignore_errors=True)
        aside.mkdir(parents=True)
        build(aside)
        aside.rename(folder)
    return [_read(each) for each in sorted(folder.iterdir())]


def write_learnt(folder: Path, images: TrainingImages, layout: SensorProfile, source: str) -> None:
    """Write images with their layout and their source."""
    said = _PROFILE.dump_json(layout).decode()
    write_images(folder, images, source={"of": source, _LAYOUT: said})


def _read(folder: Path) -> LearntImages:
    images, source = read_images(folder)
    return LearntImages(images, _PROFILE.validate_json(str(source[_LAYOUT])), str(source["of"]))


def _counted(
    clouds: Iterator[Cloud | None], on_frame: Callable[[], None]
) -> Iterator[Cloud | None]:
    for cloud in clouds:
        on_frame()
        yield cloud


def runs_of(clouds: Iterator[Cloud | None]) -> Iterator[list[Cloud]]:
    """Group frames that can be compared with each other, up to `MOST_TOGETHER`."""
    together: list[Cloud] = []
    for cloud in clouds:
        if cloud is not None:
            together.append(cloud)
        if cloud is None or len(together) == MOST_TOGETHER:
            if len(together) >= _FEWEST:
                yield together
            together = []
    if len(together) >= _FEWEST:
        yield together
