"""Frames per second of a pool of Ray and of a local pool.

Run it with `python -m tests.benchmark.pool_speed LOG --copies 6 --workers 2 --repeats 2`.

Each run serves a new state and starts a pool of workers on an empty bucket. Once the workers are
ready, all logs appear in it at once. The time counts from there until every log is done.
"""

import argparse
import logging
import shutil
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import structlog

from tests.free_ports import free_port
from tests.integration.daemons import Daemon, System
from tests.integration.ray_cluster import ray_nodes

REST_S: Final = 5.0
"""Wait after the first worker is ready, so that each is, seconds."""


@dataclass(frozen=True)
class PoolSpeed:
    """One run.

    Attributes:
        pool: Kind of the pool.
        start_s: Time from the start of the pool until a worker could take work, seconds.
        frames: Number of mined frames.
        wall_s: Time to mine them, seconds.
    """

    pool: str
    start_s: float
    frames: int
    wall_s: float

    def line(self) -> str:
        """Tell it to a person."""
        speed = self.frames / self.wall_s
        return (
            f"{self.pool:5} ready after {self.start_s:5.1f} s; {self.frames} frames in "
            f"{self.wall_s:.1f} s, {speed:.2f} frames per second"
        )


def main() -> int:
    """Measure both kinds of pool, one after the other, and again."""
    asked = argparse.ArgumentParser(prog="python -m tests.benchmark.pool_speed")
    asked.add_argument("log", type=Path, help="an .mcap file")
    asked.add_argument("--copies", type=int, default=6, help="logs in the bucket")
    asked.add_argument("--workers", type=int, default=2, help="processes of each pool")
    asked.add_argument("--repeats", type=int, default=2, help="runs of each pool")
    how = asked.parse_args()
    if not how.log.is_file():
        asked.error(f"no such log: {how.log}")
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))
    for _ in range(how.repeats):
        for pool in ("local", "ray"):
            speed = measure(pool, how.log, copies=how.copies, workers=how.workers)
            sys.stdout.write(speed.line() + "\n")
            sys.stdout.flush()
    return 0


def measure(pool: str, log: Path, *, copies: int, workers: int) -> PoolSpeed:
    """Mine copies of a log by one pool.

    Args:
        pool: `local` or `ray`.
        log: The log.
        copies: Number of copies.
        workers: Number of worker processes.
    """
    with ExitStack() as opened:
        folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="pool-speed-")))
        bucket, waiting = folder / "logs", folder / "waiting"
        bucket.mkdir()
        for number in range(copies):
            copy = waiting / f"car-{number}" / "2019-05-11" / log.name
            copy.parent.mkdir(parents=True)
            shutil.copyfile(log, copy)
        cluster = []
        if pool == "ray":
            nodes = opened.enter_context(ray_nodes(1))
            cluster = ["--pool", "ray", "--ray-address", nodes.address]
        page = f"127.0.0.1:{free_port()}"
        system = opened.enter_context(_system(folder, bucket, workers, cluster, page=page))
        for daemon in (system.router, system.service):
            daemon.start()
        system.until(lambda: system.status() is not None, "an answer")
        began_s = time.monotonic()
        system.pool.start()
        system.until(lambda: _is_ready(page), "a worker that is ready")
        start_s = time.monotonic() - began_s
        time.sleep(REST_S)
        began_s = time.monotonic()
        for each in sorted(waiting.iterdir()):
            each.rename(bucket / each.name)
        states: dict[str, str] = {}

        def all_done() -> bool:
            states.update(system.states())
            return len(states) == copies and set(states.values()) == {"done"}

        system.until(all_done, "every log done")
        wall_s = time.monotonic() - began_s
        status = system.status()
        assert status is not None
        frames = sum(each.frames for each in status.logs)
        ends = system.stop()
        assert ends == [0, 0, 0], f"{ends}: {system.pool.said()[-2000:]}"
        return PoolSpeed(pool, start_s, frames, wall_s)


@contextmanager
def _system(
    folder: Path, bucket: Path, workers: int, cluster: list[str], *, page: str
) -> Iterator[System]:
    env = {
        "COUNTERPOINT_LIST_INTERVAL_S": "0.5",
        "COUNTERPOINT_LEASE_S": "30",
        "COUNTERPOINT_SETTLE_S": "0",
        "COUNTERPOINT_WORKER_HTTP_LISTEN": page,
    }
    system = System(folder, str(bucket), env=env)
    options = ("worker", "--workers", str(workers), "--connect", system.endpoint, *cluster)
    system.pool = Daemon(folder, "pool", *options, env=env)
    system.daemons = (system.router, system.service, system.pool)
    try:
        yield system
    finally:
        system.end()


def _is_ready(page: str) -> bool:
    try:
        with urllib.request.urlopen(f"http://{page}/readyz", timeout=5) as answer:
            return bool(answer.status == 200)
    except (urllib.error.URLError, OSError):
        return False


if __name__ == "__main__":
    sys.exit(main())
