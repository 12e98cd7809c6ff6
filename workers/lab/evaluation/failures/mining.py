"""Parallel mining of many logs; cached results are not mined again."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from workers.lab.evaluation.failures.mine_log import LogJob, mine_log
from workers.lab.evaluation.failures.planting.drive import Drive, FrameRange
from workers.lab.evaluation.failures.planting.load_drive import (
    check_truth,
    load_drive,
    scenes_of,
    shard_of_drive,
)
from workers.lab.evaluation.failures.planting.mine_variant import mine_variant
from workers.lab.evaluation.failures.planting.variants import Answer
from workers.lab.evaluation.failures.result_cache import load_mined_log, store_mined_log
from workers.lab.evaluation.failures.rows import MinedLog
from workers.lab.evaluation.failures.uncertainty import NO_PROBING, ProbedStream, Probing
from workers.lab.evaluation.truth.truth import LogTruth, TruthUnusableError
from workers.parts.protocols import Parts
from workers.version import parts_of, pipeline_version


@dataclass(frozen=True, slots=True)
class MiningRun:
    """Settings of a mining run over many logs.

    Attributes:
        bucket_url: Bucket of the logs.
        settings: Mining settings of a worker.
        processes: Number of parallel processes; 1 mines in this one.
        kept: Folder of cached results; None caches nothing.
        probing: Uncertainty measures to compute in addition to the labels.
    """

    bucket_url: str
    settings: MiningSettings
    processes: int = 1
    kept: Path | None = None
    probing: Probing = NO_PROBING


def mine_logs(
    mining: MiningRun, jobs: Sequence[LogJob], *, on_log: Callable[[MinedLog], None]
) -> list[MinedLog]:
    """Mine logs, each one independently of the others, and return them in the order of the jobs.

    Args:
        mining: Settings of the run.
        jobs: Logs to mine, with their slips.
        on_log: Called with each mined log when it is done.

    Raises:
        PermanentError: If a log cannot be mined, or its truth belongs to another log.
    """
    done: dict[int, MinedLog] = {}
    for number, job in enumerate(jobs):
        found = load_mined_log(mining.kept, job, mining.settings, mining.probing)
        if found is not None:
            done[number] = found
            on_log(found)
    left = [number for number in range(len(jobs)) if number not in done]
    for number, log in _mined(mining, jobs, left):
        store_mined_log(mining.kept, jobs[number], mining.settings, mining.probing, log)
        done[number] = log
        on_log(log)
    return [done[number] for number in range(len(jobs))]


def _mined(
    mining: MiningRun, jobs: Sequence[LogJob], left: Sequence[int]
) -> Iterator[tuple[int, MinedLog]]:
    if mining.processes <= 1 or len(left) <= 1:
        for number in left:
            yield number, _mine(mining, jobs[number])
        return
    with ProcessPoolExecutor(mining.processes, mp_context=get_context("spawn")) as pool:
        waiting: dict[Future[MinedLog], int] = {
            pool.submit(_mine, mining, jobs[number]): number for number in left
        }
        try:
            while waiting:
                ready, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in sorted(ready, key=lambda each: waiting[each]):
                    yield waiting.pop(future), future.result()
        finally:
            for future in waiting:
                future.cancel()


def _mine(mining: MiningRun, job: LogJob) -> MinedLog:
    parts = _parts(mining.settings.model_dump_json(), mining.probing)
    if job.variant is None:
        return mine_log(open_bucket(mining.bucket_url), job, mining.settings, parts)
    drive = _drive(mining, replace(job, variant=None), job.variant.frames)
    version = pipeline_version(mining.settings, parts)
    return mine_variant(drive, job.variant, parts, pipeline_version=version)


def scenes_of_drive(
    mining: MiningRun, job: LogJob, frames: FrameRange, answer: Answer = Answer.POINTS
) -> int:
    """Count the scenes of a drive, and check its truth, without running any part.

    Raises:
        TruthUnusableError: If failures cannot be planted in it.
        LogUnusableError: If the log cannot be read.
    """
    truth = _truth_of(job)
    bucket = open_bucket(mining.bucket_url)
    shard, read = shard_of_drive(bucket, job.recording, truth, mining.settings, frames)
    check_truth(truth, read, frames, answer=answer)
    scenes = len(scenes_of(shard, read))
    if not scenes:
        raise TruthUnusableError(f"{job.recording.log_id} has no scene of a second in {frames}")
    return scenes


def _truth_of(job: LogJob) -> LogTruth:
    truth = LogTruth.beside(job.recording, job.truth)
    if truth is None:
        raise TruthUnusableError(f"{job.recording.log_id} has no truth in {job.truth}")
    return truth


@lru_cache(maxsize=1)
def _drive(mining: MiningRun, job: LogJob, frames: FrameRange) -> Drive:
    """Load a drive; each process keeps one, since the jobs of a drive follow one another."""
    truth = _truth_of(job)
    parts = _parts(mining.settings.model_dump_json(), mining.probing)
    bucket = open_bucket(mining.bucket_url)
    return load_drive(bucket, job.recording, truth, mining.settings, parts, frames=frames)


@lru_cache(maxsize=2)
def _parts(settings_json: str, probing: Probing) -> Parts:
    """Build the parts; each process loads the weights once."""
    settings = MiningSettings.model_validate_json(settings_json)
    parts = parts_of(settings)
    probed = ProbedStream.of(settings, probing)
    return parts if probed is None else replace(parts, supervised=probed)
