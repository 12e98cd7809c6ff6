"""Data of a training run: images of the logs, what is held out of them, and what is replayed."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from schemas.mining import MiningSettings
from schemas.runtime.named_file import open_named_file
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.recordings import EXTENSION, group_recordings
from schemas.work import Recording
from workers.lab.datasets.classes import ClassTable
from workers.lab.datasets.learnt_clouds import Labeller, ProvedLabels, TrueLabels, stretches_of
from workers.lab.datasets.learnt_images import (
    VARIANTS,
    ImageOptions,
    LearntImages,
    images_of_streets,
    images_of_stretch,
)
from workers.lab.evaluation.truth.truth import LogTruth, logs_with_truth
from workers.lab.simulation.output.samples import DEFAULT_SENSORS
from workers.lab.simulation.sensor.sensors import SensorName
from workers.lab.training.batches import TrainingSet
from workers.lab.training.errors import TrainingDataError
from workers.lidar.range_image import SensorProfile
from workers.parts.registry import build_odometry, build_selfsupervised
from workers.supervised.residual_image import ResidualSettings

TEACHER: Final = "registration:lookahead-1.0"
"""The stream whose proved labels are learnt; of its forms the one that sees most."""

HELD_OUT: Final = 5
"""One log of so many is held out; of a single log, the last such share of its images."""

MOST_HELD_OUT: Final = 40
"""Images scored at most, evenly chosen: a scoring takes as long as twenty steps."""

_STREET_SEED: Final = 7919
"""Added to the seed of a run, so that streets and batches share no random stream."""


@dataclass(frozen=True, slots=True)
class DataSettings:
    """Data of a run.

    Attributes:
        bucket: URL or path of the logs; empty: none, streets alone.
        truth: Folder of their truth; None: the proved labels of the self-supervised stream.
        frames: First frame and end of each log; None: stretches spread over it.
        most: Frames of all logs together at most.
        streets: Simulated streets to replay.
        sensors: Their sensors.
        columns: Firings per turn of simulated lidars; None: as the sensor has.
        replay: Folders with `logs` and `truth`, replayed as well.
        replay_share: Share of the windows that come from streets and replayed logs.
        seed: Seed of streets and pose errors.
    """

    bucket: str = ""
    truth: Path | None = None
    frames: tuple[int, int | None] | None = None
    most: int = 400
    streets: int = 24
    sensors: tuple[SensorName, ...] = DEFAULT_SENSORS
    columns: int | None = None
    replay: tuple[Path, ...] = ()
    replay_share: float = 0.4
    seed: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class LearningData:
    """Images of a run.

    Attributes:
        logs: Of the logs, without what is held out.
        held_out: Images that only judge, of logs or parts of a log.
        replayed: Of streets and replayed logs.
        proved: Whether the labels of `logs` are those that the self-supervised stream proved.
    """

    logs: list[LearntImages]
    held_out: list[LearntImages]
    replayed: list[LearntImages]
    proved: bool

    def training_sets(self, *, replay_share: float, replays: bool = True) -> list[TrainingSet]:
        """Return the sets to draw from: logs by their frames, replays by theirs."""
        replayed = self.replayed if replays else []
        share = replay_share if self.logs and replayed else float(not self.logs)
        return [
            *_weighed(self.logs, 1.0 - share, proved=self.proved),
            *_weighed(replayed, share, proved=False),
        ]

    def judged(self) -> dict[str, TrainingSet]:
        """Return what only judges, joined to one set for each layout, by log."""
        named: dict[str, TrainingSet] = {}
        total = sum(map(len, self.held_out))
        step = max(-(-total // MOST_HELD_OUT), 1)
        for each in self.held_out:
            part = each.part(slice(None, None, step))
            if len(part):
                name = each.source if each.source not in named else f"{each.source} {len(named)}"
                named[name] = TrainingSet(part.images, 1.0, self.proved, part.layout)
        return named


def _weighed(made: Sequence[LearntImages], share: float, *, proved: bool) -> list[TrainingSet]:
    total = sum(map(len, made))
    return [
        TrainingSet(each.images, share * len(each) / total, proved, each.layout)
        for each in made
        if share > 0
    ]


@dataclass(frozen=True, slots=True)
class DataPlan:
    """Logs and replays of a run, found but not read.

    Attributes:
        settings: Which data.
        mining: Ingest settings and parts.
        classes: Classes that truth is read as.
    """

    settings: DataSettings
    mining: MiningSettings
    classes: ClassTable = field(default_factory=ClassTable)

    def request(self) -> dict[str, Any]:
        """Name the data so that other data give another answer; reads truth, but no log.

        Raises:
            TrainingDataError: If there is no log.
        """
        settings = self.settings
        said: dict[str, Any] = {
            "frames": list(settings.frames or ()) or None,
            "most frames": settings.most,
            "streets": settings.streets,
            "street sensors": list(settings.sensors) if settings.streets else [],
            "street columns": settings.columns,
            "replay share": settings.replay_share,
        }
        if settings.bucket:
            bucket = open_bucket(settings.bucket)
            recordings = self.recordings(bucket)
            said["logs"] = {each.log_id: each.revision for each in recordings}
            said["labels"] = (
                _digest_of_truth(settings.truth, recordings)
                if settings.truth
                else build_selfsupervised(TEACHER).version
            )
        for folder in settings.replay:
            found = _replayed_logs(folder)
            said[f"replay {folder.name}"] = {each.log_id: each.revision for each, _ in found} | {
                "truth": _digest_of_truth(folder / "truth", [each for each, _ in found])
            }
        return said

    def recordings(self, bucket: Bucket) -> list[Recording]:
        """List the logs to learn from.

        Raises:
            TrainingDataError: If there is none.
            TruthUnusableError: If truth is wanted and no log has any.
        """
        if self.settings.truth is not None:
            return [recording for recording, _ in logs_with_truth(bucket, self.settings.truth)]
        found = list(group_recordings(bucket.list()))
        if not found:
            raise TrainingDataError(f"there is no log to learn from in {bucket.url}")
        return found

    def build(
        self,
        work: Path,
        *,
        profile: SensorProfile,
        residual: ResidualSettings,
        motion: bool = True,
        on_progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> LearningData:
        """Build all images in a work folder; those that are there are read.

        Args:
            work: The work folder.
            profile: Layout of the images.
            residual: Ages of the residual images.
            motion: Build the residuals of all variants, which only a motion network needs.
            on_progress: Called with the frames built, and about how many there are.

        Raises:
            TrainingDataError: If a log gave no image.
        """
        settings, done = self.settings, [0]
        total = settings.streets * 2 + (settings.most if settings.bucket else 0)

        def step() -> None:
            done[0] += 1
            on_progress(min(done[0], total), total)

        how = ImageOptions(profile, residual, VARIANTS if motion else VARIANTS[:1])
        logs, held_out = self._of_logs(work / "logs", how, step)
        replayed = images_of_streets(
            work / "streets",
            streets=settings.streets,
            sensors=settings.sensors,
            how=how,
            seed=settings.seed + _STREET_SEED,
            columns=settings.columns,
            on_window=step,
        )
        for number, folder in enumerate(settings.replay):
            replayed += self._of_replay(work / f"replay-{number}", folder, how, step)
        if not logs and not replayed:
            raise TrainingDataError(
                f"no frame could be learnt from: its pose was lost, or it has no label "
                f"({settings.bucket})"
            )
        return LearningData(logs, held_out, replayed, proved=settings.truth is None)

    def _of_logs(
        self,
        work: Path,
        how: ImageOptions,
        step: Callable[[], None],
    ) -> tuple[list[LearntImages], list[LearntImages]]:
        settings = self.settings
        if not settings.bucket:
            return [], []
        bucket = open_bucket(settings.bucket)
        recordings = self.recordings(bucket)
        made: dict[str, list[LearntImages]] = {each.log_id: [] for each in recordings}
        labeller = self._labeller(bucket)
        stretches = stretches_of(
            bucket,
            recordings,
            self.mining,
            most=settings.most,
            frames=settings.frames or self._whole(),
        )
        for number, stretch in enumerate(stretches):
            made[stretch.recording.log_id] += images_of_stretch(
                work / f"{number:04d}",
                bucket,
                stretch,
                self.mining,
                labeller,
                how=how,
                seed=settings.seed + number,
                on_frame=step,
            )
        return split(list(made.values()))

    def _whole(self) -> tuple[int, None] | None:
        """Return all frames where truth may count them from the start of a log."""
        return None if self.settings.truth is None else (0, None)

    def _labeller(self, bucket: Bucket) -> Labeller:
        odometry = build_odometry(self.mining.odometry)
        if self.settings.truth is None:
            return ProvedLabels(odometry, build_selfsupervised(TEACHER))
        known = {
            recording.log_id: truth
            for recording, truth in logs_with_truth(bucket, self.settings.truth)
        }
        return TrueLabels(odometry, known, self.classes)

    def _of_replay(
        self,
        work: Path,
        folder: Path,
        how: ImageOptions,
        step: Callable[[], None],
    ) -> list[LearntImages]:
        bucket, found = open_bucket(str(folder / "logs")), _replayed_logs(folder)
        labeller = TrueLabels(
            build_odometry(self.mining.odometry),
            {recording.log_id: truth for recording, truth in found},
            ClassTable(),
        )
        stretches = stretches_of(
            bucket,
            [recording for recording, _ in found],
            self.mining,
            most=self.settings.most,
            frames=(0, None),
        )
        made = []
        for number, stretch in enumerate(stretches):
            made += images_of_stretch(
                work / f"{number:04d}",
                bucket,
                stretch,
                self.mining,
                labeller,
                how=how,
                seed=self.settings.seed + number,
                on_frame=step,
            )
        return made


def split(
    by_log: Sequence[Sequence[LearntImages]],
) -> tuple[list[LearntImages], list[LearntImages]]:
    """Hold out one log of `HELD_OUT`; of a single log, the last share of its images.

    Args:
        by_log: Images of each log, in order of time.

    Returns:
        What is learnt, and what only judges.
    """
    logs = [[each for each in made if len(each)] for made in by_log]
    logs = [made for made in logs if made]
    if len(logs) > 1:
        chosen = {number for number in range(len(logs)) if number % HELD_OUT == HELD_OUT - 1}
        chosen = chosen or {len(logs) - 1}
        kept = [each for number, made in enumerate(logs) if number not in chosen for each in made]
        return kept, [each for number in sorted(chosen) for each in logs[number]]
    learnt: list[LearntImages] = []
    held_out: list[LearntImages] = []
    left = sum(map(len, logs[0])) // HELD_OUT if logs else 0
    for each in reversed(logs[0] if logs else []):
        cut = len(each) - min(left, len(each))
        left -= len(each) - cut
        if cut < len(each):
            held_out.insert(0, each.part(slice(cut, None)))
        if cut:
            learnt.insert(0, each.part(slice(cut)))
    return learnt, held_out


def _replayed_logs(folder: Path) -> list[tuple[Recording, LogTruth]]:
    if not (folder / "logs").is_dir() or not (folder / "truth").is_dir():
        raise TrainingDataError(
            f"--replay needs a folder with logs and truth in it, as `counterpoint simulate --out` "
            f"writes ({folder})"
        )
    return logs_with_truth(open_bucket(str(folder / "logs")), folder / "truth")


def _digest_of_truth(truth: Path, recordings: Sequence[Recording]) -> str:
    """Digest names and bytes of the truth of some logs."""
    digest = hashlib.sha256()
    folders = {truth / each.log_id for each in recordings}
    folders |= {
        truth / part.key.removesuffix(EXTENSION) for each in recordings for part in each.parts
    }
    for folder in sorted(folders):
        for path in sorted(folder.glob("*")) if folder.is_dir() else ():
            if path.suffix in (".npz", ".json") and path.is_file():
                digest.update(str(path.relative_to(truth)).encode())
                with open_named_file(path) as file:
                    digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()[:16]


def measured_profile(
    data: Sequence[TrainingSet], profile: SensorProfile, *, share: int = 50
) -> SensorProfile:
    """Compute means and deviations over all sets, each with its weight; `share` images of each."""
    means, squares, weights = [], [], []
    for training_set in data:
        images = training_set.images
        chosen = range(0, len(images.channels), max(len(images.channels) // share, 1))
        values = np.concatenate(
            [images.channels[i].astype(np.float64)[:, images.seen_mask[i]] for i in chosen], axis=1
        )
        means.append(values.mean(axis=1))
        squares.append((values**2).mean(axis=1))
        weights.append(training_set.weight)
    mean = np.average(means, axis=0, weights=weights)
    std = np.sqrt(np.average(squares, axis=0, weights=weights) - mean**2)
    return replace(
        profile,
        means=tuple(np.round(mean, 4).tolist()),
        stds=tuple(np.round(np.maximum(std, 1e-3), 4).tolist()),
    )
