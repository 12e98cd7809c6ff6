"""Confidence of the supervised stream, measured where it is right and where it is wrong.

`python -m workers.lab.evaluation.semantics.measured_confidence OUT.json` writes the table from
which simulated on-board models draw their confidence (`workers.lab.simulation.faults.confidence`).
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray

from schemas.labels import FrameLabels, MotionLabel
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from workers.lab.evaluation.motion.disturbance import Disturbance
from workers.lab.evaluation.motion.stream_runner import run_streams
from workers.lab.evaluation.truth.truth import (
    TRUTH_DYNAMIC,
    TRUTH_UNKNOWN,
    FrameTruth,
    logs_with_truth,
)
from workers.lab.simulation.output.write import write_log
from workers.lab.simulation.world.street_builder import build_street
from workers.parts.registry import build_odometry, build_supervised

SEEDS: Final = (5_001, 5_002, 5_003, 5_004)
"""Seeds of held-out streets: no weights were trained on them and no fleet contains them."""

SECONDS: Final = 6.0
LEAST_POINTS: Final = 25
QUANTILES: Final = 101
WARM_UP_FRAMES: Final = 15


def object_confidences(predicted: FrameLabels, truth: FrameTruth) -> Iterator[tuple[bool, float]]:
    """Yield, for each object of a frame, whether its labels are right, and their mean confidence.

    Objects come from the truth; all points without one, ground included, count as one more. Right
    and wrong points of an object count apart, each if they are at least `LEAST_POINTS`.
    """
    known = (truth.motion != TRUTH_UNKNOWN) & (predicted.labels != MotionLabel.UNKNOWN)
    right = (predicted.labels == MotionLabel.DYNAMIC) == (truth.motion == TRUTH_DYNAMIC)
    track = np.zeros(len(known), np.int64) - 1 if truth.track is None else truth.track
    for thing in np.unique(track[known]).tolist():
        mine = known & (track == thing)
        for is_right in (True, False):
            points = mine & (right == is_right)
            if points.sum() >= LEAST_POINTS:
                yield is_right, float(predicted.confidence[points].mean(dtype=np.float64))


def measure(folder: Path, supervised: str = "salsanext-lmnet") -> dict[str, object]:
    """Simulate streets into a folder, run the stream over them, and collect its confidences."""
    for seed in SEEDS:
        key = f"held-out/2026-01-01/street-{seed}"
        write_log(
            folder / "logs" / f"{key}.mcap",
            build_street(seed, seconds=SECONDS),
            recorded="nothing",
            truth=folder / "truth" / key,
            log_key=f"logs/{key}.mcap",
        )
    bucket = open_bucket(str(folder / "logs"))
    settings = MiningSettings(bucket=bucket.url, artifacts="memory://", supervised=supervised)
    stream = build_supervised(supervised)
    sure: dict[bool, list[float]] = {True: [], False: []}
    for recording, truth in logs_with_truth(bucket, folder / "truth"):
        for output in run_streams(
            bucket,
            recording,
            truth,
            odometry=build_odometry(settings.odometry),
            streams={"supervised": stream},
            settings=settings,
            disturbance=Disturbance(),
        ):
            true = truth.of(output.whole, number=output.number)
            if true is None or output.number < WARM_UP_FRAMES:
                continue
            for is_right, mean in object_confidences(output.labels["supervised"], true):
                sure[is_right].append(mean)
    return {
        "made_by": "python -m workers.lab.evaluation.semantics.measured_confidence",
        "stream": stream.version,
        "seeds": list(SEEDS),
        "things": {"right": len(sure[True]), "wrong": len(sure[False])},
        "right": _quantiles(sure[True]),
        "wrong": _quantiles(sure[False]),
    }


def _quantiles(values: list[float]) -> list[float]:
    steps: NDArray[np.float64] = np.linspace(0.0, 1.0, QUANTILES)
    return [round(float(value), 4) for value in np.quantile(values, steps)]


if __name__ == "__main__":
    with TemporaryDirectory() as made:
        table = measure(Path(made))
    Path(sys.argv[1]).write_text(json.dumps(table, indent=1) + "\n")
