"""Plan of `run --dry-run`: logs in the bucket, the work left, and an estimate of its duration."""

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final

from pydantic import BaseModel, ConfigDict, Field

from schemas.errors import PermanentError
from schemas.layers import Layers
from schemas.mining import LOOKAHEAD
from schemas.transport.bucket import Bucket, open_bucket
from schemas.transport.folder import Skipped
from schemas.transport.recordings import group_recordings
from schemas.work import Recording
from service.background.skipped_entries import is_wanted, skipped_among
from service.curation.status import SkippedEntries
from service.doctor.machine import NEEDED
from service.errors import NothingFoundError, StateOutdatedError
from service.settings.config import Settings
from service.store.engine import has_database
from service.store.opening import open_ledger_store_to_read
from service.store.overview import newest_pipeline
from service.store.progress import LogStanding, Standings
from service.store.served_bucket import require_served
from service.store.throughput import Pace, pace

if TYPE_CHECKING:
    from workers.layers import LayerDigests

MOST_LOOKED_INTO: Final = 32
"""Logs whose index is read, with two range reads each: enough for a mean, seconds on any bucket."""

DEFAULT_SECONDS_PER_FRAME: Final = 0.35
"""Seconds per frame of one worker without measurements. Measured by `run --once` on frames of
106,000 points, default streams, two workers on two cores; both together take a fifth longer than
one alone.
"""

ENOUGH_FRAMES: Final = 100
"""Frames below which measured times are not used; the first ones include compilation."""

_STRICT: Final = ConfigDict(frozen=True, extra="forbid")


class DryLog(BaseModel):
    """One log in the bucket."""

    model_config = _STRICT

    log_id: str
    parts: int
    bytes: int
    standing: LogStanding = Field(
        default="new",
        description="Progress of the log in the state. new, changed (mined with other objects) "
        "and anew (mined by another pipeline version): a run mines all of it. in "
        "part: it mines the rest. scores (mined by a version that differs in the score alone): it "
        "computes scores again, from the overlays. mined, refused and parked: it mines nothing.",
    )
    left_share: float = Field(
        default=1.0, ge=0, le=1, description="Share of its bytes to be mined."
    )
    parked: int = Field(default=0, description="Plans and shards of it that are not retried.")
    duration_s: float | None = Field(
        default=None, description="Lidar frames in it; None: its index was not read."
    )
    frames: int | None = Field(
        default=None, description="In all of it, or mined of it; None: not known."
    )
    problem: str = Field(
        default="", description="Cause for which it cannot be mined, if its index was read."
    )


class DryRun(BaseModel):
    """Work that a run would do, and an estimate of its hours."""

    model_config = _STRICT

    bucket: str
    logs: tuple[DryLog, ...]
    skipped: SkippedEntries
    bytes: int = Field(description="Bytes of all logs.")
    left_bytes: int = Field(description="Bytes to be mined.")
    by_standing: dict[str, int] = Field(description="Number of logs by progress in the state.")
    pipeline_version: str = Field(
        description="Pipeline version of these settings; empty: there is no state to compare "
        "with, all is left."
    )
    not_compared: str = Field(
        default="", description="Cause for which a state that is there is not compared with."
    )
    state_version: str = Field(description="The newest in the state; another one is beaten.")
    looked_into: int = Field(description="Logs with work left whose index was read.")
    frames: int | None = Field(description="To be mined, estimated by bytes; None: of no log.")
    duration_s: float | None = Field(
        description="Duration of recording to be mined, seconds, estimated by bytes."
    )
    workers: int
    seconds_per_frame: float | None = Field(
        description="Seconds of one worker per frame; None: unknown."
    )
    pace_from: str = Field(description="Basis of the seconds per frame.")
    hours: float | None = Field(
        description="Estimated hours of the work left, on this number of workers with a core each."
    )


def plan_dry_run(
    settings: Settings, *, on_progress: Callable[[int, int], None] = lambda _done, _total: None
) -> DryRun:
    """List the logs that count, read the index of a few that are not mined yet, and extrapolate.

    Nothing is written. Scenes that a state has already mined under the pipeline version of these
    settings are left out.

    Args:
        settings: Bucket, patterns, workers, and the state with earlier results and times.
        on_progress: Called with the number of logs read and to be read.

    Raises:
        NothingFoundError: If no log counts.
        OtherBucketError: If the state belongs to another bucket, for which a run would fail too.
        TransientError: If the bucket, or the database, does not answer.
        PermanentError: If it refuses.
    """
    bucket = open_bucket(settings.bucket)
    unlisted: list[Skipped] = []
    objects = list(bucket.list(on_skipped=unlisted.append))
    patterns = {"include": settings.include, "exclude": settings.exclude}
    recordings = group_recordings(each for each in objects if is_wanted(each.key, **patterns))
    if not recordings:
        raise NothingFoundError(f"no .mcap log that counts in {bucket.url}; see include, exclude")
    known = _known(settings, bucket.url, recordings)
    listed = [_listed(each, known.standings) for each in recordings]
    left = [number for number, log in enumerate(listed) if log.left_share]
    sampled = [left[i] for i in _spread(len(left))] if find_spec("mcap") is not None else []
    looked: dict[int, DryLog] = {}
    for number in sampled:
        looked[number] = _look(bucket, recordings[number], listed[number], settings)
        on_progress(len(looked), len(sampled))
    logs = tuple(looked.get(i, log) for i, log in enumerate(listed))
    measured = [log for log in looked.values() if log.frames is not None]
    unread = [log for i, log in enumerate(logs) if i not in looked or log.frames is None]
    frames = _left_of([log.frames or 0 for log in measured], measured, unread)
    seconds = _left_of([log.duration_s or 0.0 for log in measured], measured, unread)
    seconds_per_frame, pace_from = _pace(known, settings)
    return DryRun(
        bucket=bucket.url,
        logs=logs,
        skipped=skipped_among(objects, unlisted, **patterns),
        bytes=sum(log.bytes for log in logs),
        left_bytes=round(sum(log.bytes * log.left_share for log in logs)),
        by_standing=dict(Counter(log.standing for log in logs)),
        pipeline_version=known.pipeline_version,
        state_version=known.state_version,
        not_compared=known.problem,
        looked_into=len(looked),
        frames=None if frames is None else round(frames),
        duration_s=seconds,
        workers=settings.workers,
        seconds_per_frame=seconds_per_frame,
        pace_from=pace_from,
        hours=(
            None
            if frames is None or seconds_per_frame is None
            else frames * seconds_per_frame / settings.workers / 3600
        ),
    )


def _spread(count: int) -> list[int]:
    """Choose up to `MOST_LOOKED_INTO` indices at even intervals, with the first and the last."""
    chosen = min(count, MOST_LOOKED_INTO)
    return sorted({round(i * (count - 1) / max(1, chosen - 1)) for i in range(chosen)})


def _listed(recording: Recording, standings: Standings | None) -> DryLog:
    log = DryLog(
        log_id=recording.log_id,
        parts=len(recording.parts),
        bytes=sum(part.size for part in recording.parts),
    )
    if standings is None:
        return log
    found = standings.of(recording.log_id, recording.revision)
    return log.model_copy(
        update={
            "standing": found.standing,
            "left_share": found.left_share,
            "parked": found.parked,
            "frames": None if found.left_share else found.frames,
        }
    )


def _look(bucket: Bucket, recording: Recording, listed: DryLog, settings: Settings) -> DryLog:
    from workers.ingest.inspect import inspect_recording

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


def _left_of(
    amounts: Sequence[float], measured: Sequence[DryLog], unread: Sequence[DryLog]
) -> float | None:
    """Sum up the remaining work: measured for logs that were read, by bytes for the others."""
    left_bytes = sum(log.bytes * log.left_share for log in unread)
    measured_bytes = sum(log.bytes for log in measured)
    if left_bytes and not measured_bytes:
        return None
    known = sum(amount * log.left_share for amount, log in zip(amounts, measured, strict=True))
    return known + (left_bytes * sum(amounts) / measured_bytes if left_bytes else 0.0)


def _pace(known: "_Known", settings: Settings) -> tuple[float | None, str]:
    found = known.pace
    frames = 0 if found is None else found.frames
    others = _other_parts(settings)
    same = known.pipeline_version == known.state_version
    if found is not None and frames >= ENOUGH_FRAMES and (same or not others):
        return found.seconds_per_frame, f"measured on {frames} frames mined in this state"
    if others:
        return None, (
            f"no {ENOUGH_FRAMES} frames are mined in this state under this pipeline version, with "
            f"{', '.join(others)}, and the time of the defaults does not apply to them"
        )
    return (
        DEFAULT_SECONDS_PER_FRAME,
        f"{frames} frames are mined in this state, too few for an estimate: "
        f"{DEFAULT_SECONDS_PER_FRAME:g} s per frame of 100,000 points, as measured elsewhere",
    )


def _other_parts(settings: Settings) -> list[str]:
    """Return chosen parts whose time differs from that of the defaults."""
    return [
        chosen
        for part in ("supervised", "selfsupervised", "odometry")
        if (chosen := getattr(settings, part)) != Settings.model_fields[part].default
        and chosen.partition(LOOKAHEAD)[0] != Settings.model_fields[part].default
    ]


@dataclass(frozen=True, slots=True)
class _Known:
    """Data of a state; empty where there is none, or one of another schema, as `problem` says."""

    pace: Pace | None = None
    standings: Standings | None = None
    pipeline_version: str = ""
    state_version: str = ""
    problem: str = ""


def _known(settings: Settings, url: str, recordings: Sequence[Recording]) -> _Known:
    if not settings.database and not has_database(settings.state):
        return _Known()
    try:
        store = open_ledger_store_to_read(settings)
    except StateOutdatedError as error:
        return _Known(problem=str(error))
    with closing(store), store.reading() as connection:
        require_served(connection, url, recordings, name=store.name)
        newest = newest_pipeline(connection)
        layers = _layers(settings) if newest else None
        version = layers.pipeline_version if layers else newest
        stated = Layers(**asdict(layers)) if layers else None
        standings = Standings(connection, version, stated) if version else None
        return _Known(pace(connection), standings, version, newest)


def _layers(settings: Settings) -> "LayerDigests | None":
    """Return the layers that these settings make; None where workers are not installed."""
    if any(find_spec(name) is None for name in NEEDED):
        return None
    from workers.version import layers_of, parts_of

    mining = settings.mining()
    return layers_of(mining, parts_of(mining))
