"""The logs that the yardstick mines, and by which parts."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final

from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import recording_of
from tests.yardstick.frozen import FrozenScene, frozen_scene
from workers.lab.simulation.faults.plan import plan_fleet
from workers.lab.simulation.output.fleet import FleetOptions, simulate_to
from workers.mine import MinedRecord
from workers.score import score_recording

SIMULATED: Final = "simulated"
"""Folder of the log that is simulated for the run; every other bucket is below the real logs."""


@dataclass(frozen=True, slots=True)
class Run:
    """One log, mined as `counterpoint score` mines it.

    Attributes:
        name: Of the run.
        bucket: Folder of the log, below the real logs, or `SIMULATED`.
        log: How the key of the log ends.
        settings: Parts that are not the default ones.
        scenes: Scenes that are mined at most; 0: all.
    """

    name: str
    bucket: str
    log: str
    settings: dict[str, Any] = field(default_factory=dict)
    scenes: int = 0


RUNS: Final = (
    Run("pandaset", "pandaset", "pandaset-002.mcap"),
    Run("kitti-360", "kitti360", "kitti360-3000_0.mcap"),
    Run("kitti-odometry", "kitti", "kitti-odometry-00.mcap"),
    Run("kitti-raw-split", "kitti", "kitti-raw-town_0.mcap"),
    Run("simulated", SIMULATED, ".mcap"),
    Run("simulated-recorded", SIMULATED, ".mcap", {"supervised": "recorded"}, scenes=3),
    Run(
        "kitti-lookahead",
        "kitti",
        "kitti-odometry-00.mcap",
        {"selfsupervised": "registration:lookahead-0.5", "witness": "none"},
    ),
    Run("kitti-two-stage", "kitti", "kitti-odometry-00.mcap", {"selfsupervised": "two-stage"}),
    Run(
        "kitti-ground",
        "kitti",
        "kitti-odometry-00.mcap",
        {"supervised": "salsanext:ground", "selfsupervised": "ground"},
    ),
)


def simulate(folder: Path) -> None:
    """Write one log of 10 s with planted failures, always the same one."""
    plans = plan_fleet(scenes=5, seed=20, share=0.4)
    logs = simulate_to(folder.as_uri(), plans, options=FleetOptions(columns=512, odometry=True))
    if len(list(logs)) != 1:
        raise RuntimeError("the yardstick takes one simulated log")


def mine(run: Run, logs: Path, simulated: Path) -> Iterator[FrozenScene]:
    """Yield each scene of a run.

    Args:
        run: What to mine.
        logs: Folder of the real logs.
        simulated: Folder that `simulate` has filled.

    Raises:
        FileNotFoundError: If there is no such log.
        LogUnusableError: If it cannot be mined.
    """
    url = (simulated / "logs" if run.bucket == SIMULATED else logs / run.bucket).as_uri()
    bucket = open_bucket(url)
    objects = tuple(bucket.list())
    key = next((each.key for each in objects if each.key.endswith(run.log)), None)
    if key is None:
        raise FileNotFoundError(f"no log {run.log} in {url}")
    settings = MiningSettings(bucket=url, artifacts="memory://", **run.settings)
    mined: list[MinedRecord] = []
    take: Callable[[MinedRecord], None] = mined.append
    scores = score_recording(bucket, recording_of(key, iter(objects)), settings, on_scene=take)
    for _ in islice(scores, run.scenes or None):
        yield frozen_scene(mined.pop())
