"""Builds training images from simulated streets and real logs.

`python -m workers.lab.datasets.dataset --help` lists the options.
"""

import argparse
import logging
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from schemas.errors import CounterpointError, TransientError
from workers.lab.datasets.images import TrainingImages, build_images
from workers.lab.datasets.pandaset import read_clouds
from workers.lab.datasets.simulated import clouds_of
from workers.lab.datasets.stored_images import join, write_images
from workers.lab.simulation.output.samples import DEFAULT_SENSORS, street_samples
from workers.lidar.range_image import SensorProfile
from workers.lidar.sensor_rows import lay_out
from workers.supervised.residual_image import ResidualSettings

log = logging.getLogger(__name__)

PROFILE: Final = SensorProfile(
    name="any spinning lidar",
    rows=64,
    columns=512,
    fov_up_deg=15.0,
    fov_down_deg=-25.0,
    fitted=True,
)
"""Layout of the images; the number of rows is that of each sensor."""

RESIDUAL: Final = ResidualSettings(
    ages_s=(0.1, 0.2, 0.3, 0.5, 0.8), min_range_m=2.0, max_range_m=100.0
)
"""Ages of the residual images: short for fast objects, long for slow ones, within the warm-up."""

EXIT_TRANSIENT: Final = 75
"""EX_TEMPFAIL of sysexits.h."""

_WINDOWS: Final = 2
_FRAMES: Final = 10
"""Frames of each window of a street: the first two look ahead, the last two look back."""

_PAST_AND_FUTURE: Final = ((1, range(8, 10)), (-1, range(2)))


def main(argv: Sequence[str] | None = None) -> int:
    """Write training images; exit 0 when done, 1 on bad input, 75 try again."""
    args = _parser().parse_args(argv)
    logging.basicConfig(format="%(asctime)s %(message)s", level=logging.INFO)
    try:
        if args.log is not None:
            _real(args)
        else:
            _simulated(args)
    except CounterpointError as error:
        log.error("%s", error)
        return EXIT_TRANSIENT if isinstance(error, TransientError) else 1
    except FileNotFoundError as error:
        log.error("the truth is not complete: no file %s", error.filename)
        return 1
    return 0


def _simulated(args: argparse.Namespace) -> None:
    made: defaultdict[str, list[TrainingImages]] = defaultdict(list)
    profiles: dict[str, SensorProfile] = {}
    columns = (TextColumn("{task.description}"), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("streets", total=args.streets * _WINDOWS)
        samples = street_samples(
            args.seed,
            streets=args.streets,
            windows=_WINDOWS,
            frames=_FRAMES + 1,
            sensors=args.sensors,
            columns=args.columns,
        )
        for number, sample in enumerate(samples):
            clouds = clouds_of(sample)
            sensor, _, _ = sample.lidar.name.partition(" ")
            # rows as in the first street of the sensor
            profile = profiles.setdefault(sensor, lay_out(PROFILE, clouds[0].frame))
            rng = np.random.default_rng([args.seed, number])
            for direction, only in _PAST_AND_FUTURE:
                made[sensor].append(
                    build_images(
                        clouds, profile, RESIDUAL, variants=(direction,), rng=rng, only=only
                    )
                )
            bar.update(task, advance=1)
    for sensor, parts in sorted(made.items()):
        source: dict[str, str | int] = {
            "simulated": sensor,
            "seed": args.seed,
            "streets": args.streets,
        }
        write_images(args.out / sensor, join(parts), source=source)


def _real(args: argparse.Namespace) -> None:
    start, _, stop = args.frames.partition(":")
    frames = range(int(start), int(stop))
    rng = np.random.default_rng(args.seed)
    clouds = list(read_clouds(args.log, args.truth, range(frames.stop)))
    profile = lay_out(PROFILE, clouds[0].frame)
    # evaluation may use a past before the frames; training uses nothing outside of them
    known = clouds if args.judge else clouds[frames.start :]
    only = frames if args.judge else None
    variants = (1,) if args.judge else (1, -1, 2, -2)
    images = build_images(known, profile, RESIDUAL, variants=variants, rng=rng, only=only)
    write_images(args.out, images, source={"log": args.log.stem, "frames": args.frames})


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m workers.lab.datasets.dataset",
        description="Make training images of simulated streets, or of a PandaSet log with truth.",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--seed", type=int, default=1, help="seed of everything random")
    parser.add_argument(
        "--streets", type=int, default=100, help="eight images of each; a folder for each sensor"
    )
    parser.add_argument(
        "--sensors",
        nargs="+",
        choices=DEFAULT_SENSORS,
        default=DEFAULT_SENSORS,
        help="sensors to draw from",
    )
    parser.add_argument(
        "--columns", type=int, help="columns of every lidar, instead of its own number"
    )
    parser.add_argument("--log", type=Path, help="the MCAP file, instead of simulated streets")
    parser.add_argument("--truth", type=Path, help="folder of its truth")
    parser.add_argument("--frames", default="0:40", help="frames of the log, half open")
    parser.add_argument(
        "--judge",
        action="store_true",
        help="evaluation frames: residuals may use frames before them",
    )
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
