"""Failure benchmark: mines every log of a bucket that has truth and computes both tables."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from schemas.arrays import NS_PER_S
from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from workers.lab.evaluation.failures.intervals import DRAWS
from workers.lab.evaluation.failures.mine_log import LogJob
from workers.lab.evaluation.failures.mining import MiningRun, mine_logs
from workers.lab.evaluation.failures.natural import NaturalTable, natural_table
from workers.lab.evaluation.failures.planted import PlantedTable, planted_table
from workers.lab.evaluation.failures.pose_slips import Slip
from workers.lab.evaluation.failures.rows import MinedLog
from workers.lab.evaluation.failures.uncertainty import Probing
from workers.lab.evaluation.truth.truth import TruthUnusableError, logs_with_truth
from workers.lab.simulation.faults.fault_truth import FILE as PLANTED

_SLIP_SEED: Final = 0x5119


class FailureBench(BaseModel):
    """Both tables of a bucket; null where one was not requested or cannot be computed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    bucket: str
    logs: int
    judged: dict[str, str] = Field(
        default_factory=dict, description="Name of the supervised stream, by table."
    )
    variants: int = Field(
        default=0, description="Variants of each drive; 0 where the logs have their own failures."
    )
    answer: str = Field(
        default="points", description="Form in which the judged model answers: points or boxes."
    )
    within: str = Field(
        default="",
        description="`within one drive` where intervals are by variant; empty: by log or drive.",
    )
    skipped: dict[str, str] = Field(
        default_factory=dict, description="Logs in which nothing can be planted, and the reason."
    )
    planted: PlantedTable | None = None
    natural: NaturalTable | None = None

    def as_json(self) -> dict[str, Any]:
        """Return one object: *planted* at the top level, *natural* under its name."""
        planted = {} if self.planted is None else self.planted.model_dump(mode="json")
        natural = None if self.natural is None else self.natural.model_dump(mode="json")
        about = self.model_dump(mode="json", exclude={"planted", "natural"})
        return {**about, **planted, "natural": natural}


def bench_failures(
    bucket_url: str,
    truth: Path,
    settings: MiningSettings,
    *,
    tables: Sequence[str],
    processes: int,
    kept: Path | None,
    slip_logs: int = 0,
    probing: Probing,
    draws: int = DRAWS,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> FailureBench:
    """Mine the logs that have truth, and compute the requested tables.

    Args:
        bucket_url: URL or path of the bucket of logs.
        truth: Folder of its truth.
        settings: Mining settings; *planted* uses the recorded labels instead of the network's.
        tables: `planted`, `natural`, or both; with both, *planted* is skipped where no failure was
            planted.
        processes: Number of logs mined in parallel.
        kept: Folder of cached results; None caches nothing.
        slip_logs: Of *planted*: number of logs that are mined again with a slip in every scene.
        probing: Of *natural*: uncertainty measures to compute in addition to the labels.
        draws: Bootstrap draws; 0 computes no intervals.
        on_progress: Called with the number of frames mined and their total.

    Raises:
        TruthUnusableError: If no log has truth, or *planted* alone is requested where no failure
            was planted.
        LogUnusableError: If a log cannot be mined.
    """
    jobs = jobs_of(bucket_url, truth)
    with_faults = [job for job in jobs if (truth / job.recording.log_id / PLANTED).is_file()]
    if "planted" in tables and not with_faults and len(tables) == 1:
        raise TruthUnusableError(
            f"nothing was planted in the logs of {bucket_url}: no {PLANTED} in {truth}; "
            "--table natural judges a network on any truth"
        )
    plant = "planted" in tables and bool(with_faults)
    passes = [with_faults, with_faults[:slip_logs]] if plant else []
    passes += [jobs] if "natural" in tables else []
    total = sum(job.frames for each in passes for job in each)
    done = 0

    def on_log(log: MinedLog) -> None:
        nonlocal done
        done += log.frames
        on_progress(done, total)

    on_progress(0, total)
    planted = natural = None
    judged: dict[str, str] = {}
    mining = MiningRun(bucket_url, settings, processes, kept)
    if plant:
        recorded = settings.model_copy(update={"supervised": "recorded", "model": ""})
        of_car = replace(mining, settings=recorded)
        mined = mine_logs(of_car, with_faults, on_log=on_log)
        again = [
            with_slips(job, log, scene_s=settings.grid.scene_s)
            for job, log in list(zip(with_faults, mined, strict=True))[:slip_logs]
        ]
        slipping = mine_logs(of_car, again, on_log=on_log)
        judged["planted"] = recorded.supervised
        planted = planted_table(mined, slipping=slipping, draws=draws)
    if "natural" in tables:
        mined = mine_logs(replace(mining, probing=probing), jobs, on_log=on_log)
        judged["natural"] = settings.supervised
        natural = natural_table(mined, draws=draws)
    return FailureBench(
        bucket=bucket_url, logs=len(jobs), judged=judged, planted=planted, natural=natural
    )


def jobs_of(bucket_url: str, truth: Path) -> list[LogJob]:
    """List the logs of a bucket that have truth.

    Raises:
        TruthUnusableError: If there is none.
    """
    bucket = open_bucket(bucket_url)
    return [
        LogJob(recording, truth, len(found)) for recording, found in logs_with_truth(bucket, truth)
    ]


def with_slips(job: LogJob, log: MinedLog, *, scene_s: float) -> LogJob:
    """Add an odometry slip of random time and size to every scene of a log."""
    rng = np.random.default_rng([_SLIP_SEED, *job.recording.log_id.encode()])
    slips = []
    for scene in log.scenes:
        start_s = float(rng.uniform(0.3, 0.7 * scene_s))
        lasts_s = float(rng.uniform(0.2, 0.5))
        slips.append(
            Slip(
                start_ns=scene.start_ns + round(start_s * NS_PER_S),
                end_ns=scene.start_ns + round((start_s + lasts_s) * NS_PER_S),
                yaw_rad=float(rng.choice([-1.0, 1.0]) * np.deg2rad(rng.uniform(0.3, 1.5))),
                ahead_m=float(rng.uniform(-0.3, 0.3)),
            )
        )
    return replace(job, slips=tuple(slips))
