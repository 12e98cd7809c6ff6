"""Checks of `doctor` on this machine: parts of workers, processors, compiled code, clock."""

import os
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from sqlalchemy import func, select

from service.doctor.finding import Finding, ok, problem, warning
from service.errors import StateUnusableError, UsageError
from service.settings.config import Settings
from service.store.engine import StoreUnavailableError
from service.store.opening import open_ledger_store_to_read
from service.store.tables import PIPELINES, SHARDS

NEEDED: Final = ("torch", "kiss_icp", "mcap", "numba", "pypatchworkpp", "scipy", "sklearn")
"""Modules of the extra `workers`."""

WORKER_BYTES: Final = 1_000_000_000
"""Memory of one worker at most, on frames of 100,000 points, bytes."""

STEPPED_BACK_S: Final = 60.0


def camera(settings: Settings) -> Iterator[Finding]:
    """Read the calibration of the camera, if the settings name a file."""
    if settings.camera:
        settings.mining()  # what it raises names the file
        yield ok("camera", f"its view is compared: {settings.camera}")


def parts(settings: Settings) -> Iterator[Finding]:
    """Build odometry and both streams, which loads and checks their weights."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        yield warning(
            "workers",
            f"the extra `workers` is absent ({', '.join(missing)}): this machine can serve, not "
            "mine; pip install 'counterpoint[workers]'",
        )
        return
    from workers.version import parts_of, pipeline_version

    # its camera has a check of its own, and no part reads it
    mining = settings.model_copy(update={"camera": ""}).mining()
    built = parts_of(mining)  # what it raises names the part or the file of weights
    yield ok("weights", f"loaded: {built.supervised.version}")
    yield ok("streams", f"{built.selfsupervised.version}, {built.odometry.version}")
    with suppress(UsageError):  # said under `camera`
        yield _expected(settings, pipeline_version(settings.mining(), built))


def _expected(settings: Settings, version: str) -> Finding:
    """Warn of a version whose workers would get no work from a service with these settings."""
    if version in settings.expected_versions:
        return ok("pipeline version", f"{version}, which is expected")
    if not settings.expected_versions:
        if settings.is_on_loopback:
            return ok("pipeline version", version)
        known = _known_versions(settings)
        if not known or version in known:
            return ok("pipeline version", version)
    return warning(
        "pipeline version",
        f"{version} is not expected, so its workers would get no work: write "
        f'expected_versions = ["{version}"] into the settings of the service',
    )


def _known_versions(settings: Settings) -> frozenset[str]:
    """Return the versions of the ledger; none where it cannot be read."""
    try:
        store = open_ledger_store_to_read(settings)
    except (StateUnusableError, StoreUnavailableError):  # said under `database`
        return frozenset()
    with closing(store), store.reading() as connection:
        return frozenset(connection.execute(select(PIPELINES.c.pipeline_version)).scalars())


def devices(settings: Settings) -> Iterator[Finding]:
    """Compare processors and memory with the configured number of workers."""
    cores = len(os.sched_getaffinity(0))
    has = f"{settings.workers} workers on {cores} processors"
    if settings.workers > cores:
        yield warning("devices", f"{has}: more workers than processors mine no faster")
    else:
        yield ok("devices", has)
    free = _available_bytes()
    if free is not None and free < settings.workers * WORKER_BYTES:
        yield warning(
            "devices",
            f"{free / 1e9:.1f} GB of memory are free, {settings.workers} workers may take "
            f"{settings.workers * WORKER_BYTES / 1e9:.0f}: start fewer",
        )
    elif free is not None:
        yield ok("devices", f"{free / 1e9:.1f} GB of memory are free")
    if find_spec("torch") is not None and find_spec("workers") is not None:
        yield _networks_on(settings.device)


def _networks_on(wanted: str) -> Finding:
    """Say which device the networks take by the setting `device`."""
    import torch

    from workers.checkpoints.devices import device_of
    from workers.checkpoints.errors import WeightsUnusableError

    try:
        device = device_of(wanted)
    except WeightsUnusableError as error:
        return problem("devices", str(error))
    if device == "cuda":
        return ok("devices", f"the networks run on {torch.cuda.get_device_name()}, shared by all")
    if torch.cuda.is_available():
        return ok("devices", "the networks run on the processor, since device is cpu")
    return ok(
        "devices",
        "no CUDA, and none is needed: the networks run on the processor; torch would take "
        f"{torch.get_num_threads()} threads, a worker takes one",
    )


def compiled_code(_settings: Settings) -> Iterator[Finding]:
    """Check the folder of numba's compiled loops; without one it compiles none."""
    if find_spec("numba") is None or find_spec("workers") is None:
        return
    from numba.core.caching import FunctionCache

    from workers.points.compiled import compiled

    try:
        place = FunctionCache(compiled).cache_path  # type: ignore[no-untyped-call]
    except RuntimeError:
        yield problem(
            "compiled code",
            "can be kept nowhere, so no worker can start: set NUMBA_CACHE_DIR to a folder that can "
            "be written",
        )
    else:
        yield ok("compiled code", f"can be kept ({place})")


def clock(settings: Settings) -> Iterator[Finding]:
    """Compare the clock with the newest commit, since leases and rates depend on it."""
    now_s = time.clock_gettime(time.CLOCK_REALTIME)
    said = datetime.fromtimestamp(now_s, tz=UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    try:
        store = open_ledger_store_to_read(settings)
    except (StateUnusableError, StoreUnavailableError):  # said under `database`
        yield ok("clock", said)
        return
    with closing(store), store.reading() as connection:
        newest_s = connection.execute(select(func.max(SHARDS.c.committed_s))).scalar_one()
    if newest_s is not None and newest_s > now_s + STEPPED_BACK_S:
        yield problem(
            "clock",
            f"{said} is {newest_s - now_s:.0f} s before the newest commit: the clock was set back; "
            "correct it, nothing is lost meanwhile",
        )
    else:
        yield ok("clock", said)


def _available_bytes(meminfo: Path = Path("/proc/meminfo")) -> int | None:
    if not meminfo.is_file():
        return None
    for line in meminfo.read_text(encoding="ascii").splitlines():
        name, _, rest = line.partition(":")
        if name == "MemAvailable":
            return int(rest.split()[0]) * 1024
    return None
