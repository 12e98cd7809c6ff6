"""`run --dry-run`: what lies in the bucket, and about how long mining all of it would take."""

from collections.abc import Callable, Sequence
from contextlib import closing
from importlib.util import find_spec
from typing import Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.bucket import Bucket, open_bucket
from schemas.errors import PermanentError
from schemas.recordings import group_recordings
from schemas.work import Recording
from service.bucket_watch import is_wanted
from service.config import Settings
from service.errors import NothingFoundError, StateUnusableError
from service.store.opening import open_ledger_store_to_read
from service.store.pace import Pace, pace

MOST_LOOKED_INTO: Final = 32
"""Logs whose index is read, two range reads each: enough for a mean, seconds on any bucket."""

DEFAULT_SECONDS_PER_FRAME: Final = 0.7
"""Measured by `bench pipeline` on a frame of 106,000 points, default streams, one thread."""

ENOUGH_FRAMES: Final = 100
"""Of fewer, the first ones, which compile what they need, tell too much."""

_STRICT: Final = ConfigDict(frozen=True, extra="forbid")


class DryLog(BaseModel):
    """One log that would be mined."""

    model_config = _STRICT

    log_id: str
    parts: int
    bytes: int
    duration_s: float | None = Field(default=None, description="None: not looked into.")
    frames: int | None = Field(default=None, description="None: not looked into, or not indexed.")
    problem: str = Field(default="", description="Why it cannot be mined, of those looked into.")


class DryRun(BaseModel):
    """What a run would mine, and an estimate of the hours."""

    model_config = _STRICT

    bucket: str
    logs: tuple[DryLog, ...]
    bytes: int = Field(description="Of all logs.")
    looked_into: int = Field(description="Logs whose index was read, spread evenly.")
    frames: int | None = Field(description="Estimated by bytes from those; None: none of use.")
    duration_s: float | None = Field(description="Of recording, estimated likewise.")
    workers: int
    seconds_per_frame: float
    pace_from: str = Field(description="What the seconds per frame stand on.")
    hours: float | None = Field(description="On so many workers, a core each.")


def plan_dry_run(
    settings: Settings, *, on_progress: Callable[[int, int], None] = lambda _done, _total: None
) -> DryRun:
    """List the logs that count, look into a few, and extrapolate. Nothing is written.

    Args:
        settings: Bucket, patterns, workers, and the state that may tell how fast mining is here.
        on_progress: Told logs looked into and to look into.

    Raises:
        NothingFoundError: If no log counts.
        TransientError: If the bucket does not answer.
        PermanentError: If it refuses.
    """
    bucket = open_bucket(settings.bucket)
    recordings = group_recordings(
        found
        for found in bucket.list()
        if is_wanted(found.key, include=settings.include, exclude=settings.exclude)
    )
    if not recordings:
        raise NothingFoundError(f"no .mcap log that counts in {bucket.url}; see include, exclude")
    sampled = _spread(len(recordings)) if find_spec("mcap") is not None else []
    looked: dict[int, DryLog] = {}
    for number in sampled:
        looked[number] = _look(bucket, recordings[number], settings)
        on_progress(len(looked), len(sampled))
    logs = tuple(looked.get(i) or _listed(each) for i, each in enumerate(recordings))
    total = sum(log.bytes for log in logs)
    told = [log for log in looked.values() if log.frames is not None]
    frames = _extrapolated([log.frames or 0 for log in told], told, total)
    seconds = _extrapolated([log.duration_s or 0.0 for log in told], told, total)
    seconds_per_frame, pace_from = _pace(settings)
    return DryRun(
        bucket=bucket.url,
        logs=logs,
        bytes=total,
        looked_into=len(looked),
        frames=None if frames is None else round(frames),
        duration_s=seconds,
        workers=settings.workers,
        seconds_per_frame=seconds_per_frame,
        pace_from=pace_from,
        hours=None if frames is None else frames * seconds_per_frame / settings.workers / 3600,
    )


def _spread(count: int) -> list[int]:
    """Choose up to `MOST_LOOKED_INTO` of so many, evenly, the first and the last among them."""
    chosen = min(count, MOST_LOOKED_INTO)
    return sorted({round(i * (count - 1) / max(1, chosen - 1)) for i in range(chosen)})


def _listed(recording: Recording) -> DryLog:
    size = sum(part.size for part in recording.parts)
    return DryLog(log_id=recording.log_id, parts=len(recording.parts), bytes=size)


def _look(bucket: Bucket, recording: Recording, settings: Settings) -> DryLog:
    from workers.ingest.inspect import inspect_recording

    listed = _listed(recording)
    try:
        report = inspect_recording(bucket, recording, settings.mining())
    except PermanentError as error:
        return listed.model_copy(update={"frames": 0, "duration_s": 0.0, "problem": str(error)})
    found = {
        "frames": 0 if report.refused else report.frames,
        "duration_s": report.duration_s,
        "problem": report.refused,
    }
    return listed.model_copy(update=found)


def _extrapolated(
    amounts: Sequence[float], of_logs: Sequence[DryLog], total_bytes: int
) -> float | None:
    looked_bytes = sum(log.bytes for log in of_logs)
    return sum(amounts) * total_bytes / looked_bytes if looked_bytes else None


def _pace(settings: Settings) -> tuple[float, str]:
    found = _mined_pace(settings)
    frames = 0 if found is None else found.frames
    if found is not None and frames >= ENOUGH_FRAMES:
        return found.seconds_per_frame, f"measured on {frames} frames mined in this state"
    return (
        DEFAULT_SECONDS_PER_FRAME,
        f"{frames} frames are mined in this state, too few to go by: "
        f"{DEFAULT_SECONDS_PER_FRAME:g} s per frame of 100,000 points, as measured elsewhere",
    )


def _mined_pace(settings: Settings) -> Pace | None:
    try:
        store = open_ledger_store_to_read(settings)
    except StateUnusableError:  # none there yet, or of another version: it tells us nothing
        return None
    with closing(store), store.reading() as connection:
        return pace(connection)
