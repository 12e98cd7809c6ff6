"""Trains one network of the supervised stream: `python -m workers.lab.training.train --help`."""

import argparse
import logging
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

import numpy as np
import torch

from schemas.errors import CounterpointError, TransientError
from workers.lab.datasets.classes import meanings
from workers.lab.datasets.dataset import EXIT_TRANSIENT, PROFILE, RESIDUAL
from workers.lab.datasets.stored_images import read_images
from workers.lab.training.fit import TrainingSet, TrainingSettings, train
from workers.lidar.range_image import SensorProfile
from workers.supervised.weights import LoadedWeights, WeightsCard, load_weights

log = logging.getLogger(__name__)

CHANNELS: Final = ("range", "x", "y", "z")
"""Input channels. Intensity is absent: its scale differs tenfold between sensors."""

ATTRIBUTION: Final = "PandaSet by Hesai and Scale AI (https://pandaset.org); simulated streets"
LICENCE: Final = (
    "PandaSet: CC BY 4.0; changed: sweeps brought back to the sensor's space, rounded to 1/512 m"
)


def main(argv: Sequence[str] | None = None) -> int:
    """Train a network and write its weights; exit 0 when done, 1 on bad input, 75 try again."""
    args = _parser().parse_args(argv)
    logging.basicConfig(format="%(asctime)s %(message)s", level=logging.INFO)
    try:
        _run(args)
    except CounterpointError as error:
        log.error("%s", error)
        return EXIT_TRANSIENT if isinstance(error, TransientError) else 1
    return 0


def _run(args: argparse.Namespace) -> None:
    torch.set_num_threads(args.threads)
    settings = TrainingSettings(
        steps=args.steps,
        driving_weight=args.driving_weight,
        balance=args.balance,
        peak_rate=args.peak_rate,
        batch=args.batch,
        fixed_norms=args.fixed_norms,
        lovasz_every=args.lovasz_every,
        bfloat16=args.bfloat16,
        seed=args.seed,
    )
    training_sets, sources = [], []
    for text in args.learn:
        folder, _, weight = text.rpartition("=") if "=" in text else (text, "", "1")
        images, source = read_images(Path(folder))
        training_sets.append(TrainingSet(images, float(weight)))
        sources.append(
            " ".join(f"{name} {value}" for name, value in source.items()) + f" x{weight}"
        )
    judged = {Path(folder).name: read_images(Path(folder))[0] for folder in args.judge}
    initial = None if args.initial is None else load_weights(args.initial)
    card = WeightsCard(
        network=args.model,
        classes=meanings(args.model),
        width=args.width,
        profile=_measured(training_sets) if initial is None else _as_before(initial),
        channels=CHANNELS,
        residual=None if args.model == "salsanext" else RESIDUAL,
        attribution=ATTRIBUTION,
        data_license=LICENCE,
        training={
            **asdict(settings),
            "learnt": "; ".join(sources),
            "initial": "" if initial is None else initial.digest,
        },
    )
    train(training_sets, judged, card, settings, initial=initial, out=args.out)


def _as_before(initial: LoadedWeights) -> SensorProfile:
    """Return the means and deviations of the initial weights, which fit their kernels."""
    return replace(PROFILE, means=initial.profile.means, stds=initial.profile.stds)


def _measured(training_sets: Sequence[TrainingSet]) -> SensorProfile:
    """Compute means and deviations over all sensors, each with its weight."""
    means, squares, weights = [], [], []
    for training_set in training_sets:
        images = training_set.images
        chosen = range(0, len(images.channels), max(len(images.channels) // 50, 1))
        values = np.concatenate(
            [images.channels[i].astype(np.float64)[:, images.seen_mask[i]] for i in chosen], axis=1
        )
        means.append(values.mean(axis=1))
        squares.append((values**2).mean(axis=1))
        weights.append(training_set.weight)
    mean = np.average(means, axis=0, weights=weights)
    std = np.sqrt(np.average(squares, axis=0, weights=weights) - mean**2)
    return replace(
        PROFILE,
        means=tuple(np.round(mean, 4).tolist()),
        stds=tuple(np.round(np.maximum(std, 1e-3), 4).tolist()),
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m workers.lab.training.train",
        description="Train one network of the supervised stream on training images.",
    )
    parser.add_argument("--model", choices=("salsanext", "lmnet"), required=True)
    parser.add_argument("--out", type=Path, required=True, help="the .safetensors file to write")
    parser.add_argument(
        "--learn",
        nargs="+",
        required=True,
        metavar="FOLDER[=WEIGHT]",
        help="training images of one sensor each, and their sampling weight",
    )
    parser.add_argument("--judge", nargs="*", default=[], metavar="FOLDER", help="images to score")
    parser.add_argument("--width", type=int, default=8, help="channels of the first stage")
    parser.add_argument("--steps", type=int, default=2400)
    parser.add_argument("--batch", type=int, default=2, help="windows per step")
    parser.add_argument("--initial", type=Path, help="weights to continue from")
    parser.add_argument(
        "--driving-weight", type=float, default=2.0, help="weight of frames in which the car drives"
    )
    parser.add_argument("--balance", type=float, default=0.5, help="exponent of class weights")
    parser.add_argument("--peak-rate", type=float, default=4e-3)
    parser.add_argument(
        "--fixed-norms",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="share of the last steps that normalise by running means, as in use",
    )
    parser.add_argument(
        "--lovasz-every", type=int, default=1, metavar="N", help="each N-th pixel counts for it"
    )
    parser.add_argument("--bfloat16", action="store_true", help="convolve in bfloat16")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
