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
from workers.lab.evaluation.failures.result_cache import load_mined_log, store_mined_log
from workers.lab.evaluation.failures.rows import MinedLog
from workers.lab.evaluation.failures.uncertainty import NO_PROBING, ProbedStream, Probing
from workers.parts.protocols import Parts
from workers.version import parts_of


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
    return mine_log(open_bucket(mining.bucket_url), job, mining.settings, parts)


@lru_cache(maxsize=2)
def _parts(settings_json: str, probing: Probing) -> Parts:
    """Build the parts; each process loads the weights once."""
    settings = MiningSettings.model_validate_json(settings_json)
    parts = parts_of(settings)
    probed = ProbedStream.of(settings, probing)
    return parts if probed is None else replace(parts, supervised=probed)
