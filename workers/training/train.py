"""Train one network of the supervised stream: `python -m workers.training.train --help`."""

import argparse
import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import torch

from schemas.errors import CounterpointError, TransientError
from workers.geometry.range_image import SensorProfile
from workers.supervised.classes import ClassMeaning
from workers.supervised.lmnet import MOTION_CLASSES
from workers.supervised.residual_image import ResidualSettings
from workers.supervised.weights import WeightsCard, load_weights
from workers.training.fit import TrainingSettings, train
from workers.training.images import TrainingImages, build_images
from workers.training.pandaset import CLASSES, PANDAR64_DEG, read_clouds

log = logging.getLogger(__name__)

PROFILE: Final = SensorProfile(
    name="pandar64",
    rows=64,
    columns=1024,
    fov_up_deg=16.0,
    fov_down_deg=-26.0,
    elevations_deg=PANDAR64_DEG,
)
"""Layout of the training images; means and deviations are measured on the training frames."""

RESIDUAL: Final = ResidualSettings(
    ages_s=(0.1, 0.2, 0.3, 0.5, 0.8), min_range_m=2.0, max_range_m=100.0
)
"""Young frames show fast things, old ones slow things; nothing is older than the warm-up."""

EXIT_TRANSIENT: Final = 75
"""EX_TEMPFAIL of sysexits.h."""

ATTRIBUTION: Final = "PandaSet by Hesai and Scale AI (https://pandaset.org)"
CHANGES: Final = "sweeps brought back to the sensor's space, rounded to 1/512 m"


def main(argv: Sequence[str] | None = None) -> int:
    """Train a network and write its weights; exit 0 when done, 1 on bad input, 75 try again."""
    args = _parser().parse_args(argv)
    logging.basicConfig(format="%(asctime)s %(message)s", level=logging.INFO)
    try:
        _run(args)
    except CounterpointError as error:
        log.error("%s", error)
        return EXIT_TRANSIENT if isinstance(error, TransientError) else 1
    except FileNotFoundError as error:
        log.error("the truth is not complete: no file %s", error.filename)
        return 1
    return 0


def _run(args: argparse.Namespace) -> None:
    torch.set_num_threads(args.threads)
    settings = TrainingSettings(
        model=args.model,
        width=args.width,
        steps=args.steps,
        driving_weight=args.driving_weight,
        stop_after=args.stop_after,
        balance=args.balance,
        peak_rate=args.peak_rate,
        seed=args.seed,
    )
    initial = None if args.initial is None else load_weights(args.initial)
    train_on, score_on = _frames(args.frames), _frames(args.held_out)
    rng = np.random.default_rng(settings.seed)
    residual = replace(RESIDUAL, ages_s=() if settings.model == "salsanext" else RESIDUAL.ages_s)
    clouds = list(read_clouds(args.log, args.truth, range(max(train_on.stop, score_on.stop))))
    log.info("read %d frames", len(clouds))
    learn = build_images(
        clouds[train_on.start : train_on.stop], PROFILE, residual, variants=args.variants, rng=rng
    )
    judge = build_images(clouds, PROFILE, residual, variants=(1,), rng=rng, only=score_on)
    log.info("built %d and %d images", len(learn.channels), len(judge.channels))
    profile = _measured(learn)
    card = WeightsCard(
        network=args.model,
        classes=_meanings(args.model),
        width=settings.width,
        profile=profile,
        residual=None if settings.model == "salsanext" else residual,
        attribution=ATTRIBUTION,
        data_license=f"CC BY 4.0; changed: {CHANGES}",
        training={
            "log": args.log.stem,
            "frames": args.frames,
            "held_out": args.held_out,
            "seed": settings.seed,
            "steps": settings.steps,
            "batch": settings.batch,
            "columns": settings.columns,
            "driving_weight": settings.driving_weight,
            "variants": " ".join(map(str, args.variants)),
            "stop_after": settings.stop_after,
            "balance": settings.balance,
            "peak_rate": settings.peak_rate,
            "initial": "" if initial is None else initial.digest,
        },
    )
    train(learn, judge, card, settings, initial=initial, out=args.out)


def _measured(images: TrainingImages) -> SensorProfile:
    values = images.channels.transpose(1, 0, 2, 3)[:, images.seen_mask].astype(np.float64)
    return replace(
        PROFILE,
        means=tuple(round(float(mean), 4) for mean in values.mean(axis=1)),
        stds=tuple(round(float(std), 4) for std in values.std(axis=1)),
    )


def _meanings(model: str) -> tuple[ClassMeaning, ...]:
    if model == "lmnet":
        return tuple(ClassMeaning(name=name) for name in MOTION_CLASSES)
    return tuple(ClassMeaning(name=name, movable=movable) for name, movable in CLASSES)


def _frames(text: str) -> range:
    start, _, stop = text.partition(":")
    return range(int(start), int(stop))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m workers.training.train",
        description="Train one network of the supervised stream on a PandaSet log with its truth.",
    )
    parser.add_argument("--model", choices=("salsanext", "lmnet"), required=True)
    parser.add_argument("--log", type=Path, required=True, help="the MCAP file")
    parser.add_argument("--truth", type=Path, required=True, help="folder of its truth")
    parser.add_argument("--out", type=Path, required=True, help="the .safetensors file to write")
    parser.add_argument("--frames", default="0:40", help="frames to learn from, half open")
    parser.add_argument("--held-out", default="40:56", help="frames to score, half open")
    parser.add_argument("--width", type=int, default=8, help="channels of the first stage")
    parser.add_argument("--steps", type=int, default=2400)
    parser.add_argument("--stop-after", type=int, default=0, help="stop short of the schedule")
    parser.add_argument("--initial", type=Path, help="weights to go on from")
    parser.add_argument(
        "--variants",
        type=int,
        nargs="+",
        default=(1, -1, 2, -2),
        help="speeds at which the scene is played: backwards below zero",
    )
    parser.add_argument(
        "--driving-weight", type=float, default=4.0, help="weight of frames in which the car drives"
    )
    parser.add_argument("--balance", type=float, default=1.0, help="exponent of class weights")
    parser.add_argument("--peak-rate", type=float, default=4e-3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
