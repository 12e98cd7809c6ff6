"""Mining of the loop's fleet with its own model, and the truth of chosen scenes as images."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import tee
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from schemas.arrays import NS_PER_S
from schemas.frame import PosedFrame
from schemas.labels import FrameLabels
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from workers.lab.datasets.classes import ClassTable
from workers.lab.datasets.learnt_clouds import Stretch, TrueLabels
from workers.lab.datasets.learnt_images import ImageOptions, LearntImages, images_of_stretch
from workers.lab.evaluation.failures.mine_log import LogJob, mine_log
from workers.lab.evaluation.failures.rows import MinedLog
from workers.lab.evaluation.truth.truth import LogTruth, logs_with_truth
from workers.lab.evaluation.truth.whole_log import shards_of_log
from workers.lab.loop.model import EVERY, PAST, PROFILE, RESIDUAL
from workers.lidar.range_image import RangeImage
from workers.parts.protocols import Parts
from workers.parts.registry import build_odometry
from workers.supervised.stream import RangeImageStream
from workers.supervised.weights import LoadedWeights
from workers.version import parts_of

FRAMES_PER_S: Final = 10


class MinedByModel(BaseModel):
    """A log of the fleet, mined with the model of the loop."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    log: MinedLog
    entropy: dict[str, float] = Field(description="Mean entropy of the model, by scene.")


class MotionNetworkStream(RangeImageStream):
    """The supervised stream of one motion network, which keeps its mean entropy by frame."""

    def __init__(self, model: LoadedWeights) -> None:
        super().__init__(None, model, name="lmnet-of-the-loop")
        self.entropy: dict[int, float] = {}
        self._last = 0.0

    def __call__(self, frames: Iterable[PosedFrame]) -> Iterator[FrameLabels]:
        """Yield the labels of each frame, in order."""
        stamped, mine = tee(frames)
        for posed, labels in zip(stamped, super().__call__(mine), strict=True):
            self.entropy[posed.frame.stamp_ns] = self._last
            yield labels

    def _fused(
        self, image: RangeImage, answers: Sequence[NDArray[np.float32]], *, has_past: bool
    ) -> FrameLabels:
        shares = np.clip(answers[0][1:], 1e-7, 1.0)
        shares = shares / shares.sum(axis=0)
        entropy = -(shares * np.log(shares)).sum(axis=0) / np.log(len(shares))
        seen = image.seen_mask
        self._last = float(entropy[seen].mean()) if seen.any() else 0.0
        return super()._fused(image, answers, has_past=has_past)


def jobs_of_fleet(fleet: Path) -> list[LogJob]:
    """List the logs of a fleet, which lie in `logs` with their truth in `truth`.

    Raises:
        TruthUnusableError: If no log has truth.
    """
    bucket = open_bucket(str(fleet / "logs"))
    truth = fleet / "truth"
    return [
        LogJob(recording, truth, len(found)) for recording, found in logs_with_truth(bucket, truth)
    ]


def mine_with(
    fleet: Path, job: LogJob, model: LoadedWeights, settings: MiningSettings, *, kept: Path
) -> MinedByModel:
    """Mine a log with a model as the supervised stream, or read what was mined before.

    Args:
        fleet: Folder of the fleet.
        job: The log.
        model: The model.
        settings: Mining settings; the supervised stream and the weights are not used.
        kept: Folder of the results of this model alone.

    Raises:
        LogUnusableError: If the log cannot be mined.
    """
    file = kept / f"{job.recording.log_id.replace('/', '-')}.json"
    mined = _read(file)
    if mined is None:
        others = settings.model_copy(update={"supervised": "recorded", "model": ""})
        stream = MotionNetworkStream(model)
        parts = replace(_parts(others.model_dump_json()), supervised=stream)
        log = mine_log(open_bucket(str(fleet / "logs")), job, settings, parts)
        mined = MinedByModel(log=log, entropy=_by_scene(log, stream.entropy))
        kept.mkdir(parents=True, exist_ok=True)
        growing = file.with_suffix(".part")
        growing.write_text(mined.model_dump_json())
        growing.replace(file)
    return mined


@lru_cache(maxsize=1)
def _parts(settings_json: str) -> Parts:
    return parts_of(MiningSettings.model_validate_json(settings_json))


def _read(file: Path) -> MinedByModel | None:
    if not file.is_file():
        return None
    try:
        return MinedByModel.model_validate_json(file.read_text())
    except ValidationError:  # of an earlier form: it is mined again
        return None


def _by_scene(log: MinedLog, entropy: dict[int, float]) -> dict[str, float]:
    found = {}
    for scene in log.scenes:
        end_ns = scene.start_ns + round(scene.seconds * NS_PER_S)
        inside = [value for stamp, value in entropy.items() if scene.start_ns <= stamp < end_ns]
        found[scene.scene_id] = round(float(np.mean(inside)), 6) if inside else 0.0
    return found


def scene_labels(
    fleet: Path, log_id: str, cell: int, settings: MiningSettings, *, kept: Path
) -> list[LearntImages]:
    """Return the truth of a scene as training images, as a labeller would return it.

    These are every second frame that has its past within the scene. They are built when they are
    first asked for.

    Args:
        fleet: Folder of the fleet.
        log_id: Log of the scene.
        cell: Number of the scene in its log.
        settings: Ingest settings and odometry.
        kept: Folder of the images of all scenes.

    Raises:
        TruthUnusableError: If the log has no truth.
    """
    bucket = open_bucket(str(fleet / "logs"))
    job = next(each for each in jobs_of_fleet(fleet) if each.recording.log_id == log_id)
    truth = LogTruth.beside(job.recording, job.truth)
    known = {} if truth is None else {log_id: truth}
    length = round(settings.grid.scene_s * FRAMES_PER_S)
    shard = shards_of_log(bucket, job.recording, settings)[0]
    made = images_of_stretch(
        kept / f"{log_id.replace('/', '-')}-{cell:03d}",
        bucket,
        Stretch(job.recording, shard, range(cell * length, (cell + 1) * length)),
        settings,
        TrueLabels(build_odometry(settings.odometry), known, ClassTable()),
        how=ImageOptions(PROFILE, RESIDUAL, (1,)),
        seed=cell,
    )
    return [part for each in made if len(part := each.part(slice(PAST, None, EVERY)))]
