"""Failure benchmark of real drives: plants failures by seed, mines the variants, and ranks them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from schemas.mining import MiningSettings
from workers.lab.evaluation.failures.bench import FailureBench, jobs_of
from workers.lab.evaluation.failures.intervals import DRAWS, MIN_LOGS
from workers.lab.evaluation.failures.mining import MiningRun, mine_logs, scenes_of_drive
from workers.lab.evaluation.failures.planted import planted_table
from workers.lab.evaluation.failures.planting.planted_file import PlantedFile, planted_file
from workers.lab.evaluation.failures.planting.variants import Planting, plan_variants
from workers.lab.evaluation.failures.rows import MinedLog
from workers.lab.evaluation.truth.truth import TruthUnusableError


def bench_planting(
    bucket_url: str,
    truth: Path,
    settings: MiningSettings,
    planting: Planting,
    *,
    processes: int,
    kept: Path | None,
    draws: int = DRAWS,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[FailureBench, PlantedFile]:
    """Plant failures in labels made from the truth of real drives, and rank their scenes.

    Args:
        bucket_url: URL or path of the bucket of logs.
        truth: Folder of its truth.
        settings: Mining settings; the supervised stream is the recorded one.
        planting: Number of variants, seed, frames, share and noise.
        processes: Number of variants mined in parallel.
        kept: Folder of cached results; None caches nothing.
        draws: Bootstrap draws; 0 computes no intervals.
        on_progress: Called with the number of variants mined and their total.

    Returns:
        The tables, and the list of what was planted.

    Raises:
        TruthUnusableError: If no log has truth with motion and tracks.
        LogUnusableError: If a log cannot be mined.
    """
    recorded = settings.model_copy(update={"supervised": "recorded", "model": ""})
    mining = MiningRun(bucket_url, recorded, processes, kept)
    drives = {job.recording.log_id: job for job in jobs_of(bucket_url, truth)}
    scenes, skipped = {}, {}
    for log_id, job in drives.items():
        try:
            scenes[log_id] = scenes_of_drive(mining, job, planting.frames, planting.answer)
        except TruthUnusableError as error:
            skipped[log_id] = str(error)
    if not scenes:
        raise TruthUnusableError("; ".join(skipped.values()))
    plan = plan_variants(planting, scenes)
    jobs = [
        replace(drives[log_id], variant=variant)
        for log_id, variants in plan.items()
        for variant in variants
    ]
    done = 0
    on_progress(0, len(jobs))

    def on_log(log: MinedLog) -> None:
        nonlocal done
        done += 1
        on_progress(done, len(jobs))

    mined = mine_logs(mining, jobs, on_log=on_log)
    names = sorted(plan)
    by_drive = len(names) >= MIN_LOGS
    groups = [names.index(job.recording.log_id) for job in jobs] if by_drive else None
    bench = FailureBench(
        bucket=bucket_url,
        logs=len(names),
        judged={"planted": recorded.supervised},
        variants=planting.variants,
        answer=planting.answer.value,
        within=_within(len(names)),
        skipped=skipped,
        planted=planted_table(mined, groups=groups, draws=draws),
    )
    return bench, planted_file(bucket_url, planting, mined)


def _within(drives: int) -> str:
    """Return where the variants are from, where there are too few drives to draw drives."""
    if drives >= MIN_LOGS:
        return ""
    return "within one drive" if drives == 1 else f"within {drives} drives"
