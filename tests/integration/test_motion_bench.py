import subprocess
import sys
from pathlib import Path

import pytest

from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.factories import street_log
from workers.errors import LogUnusableError
from workers.lab.evaluation.benchmarks.bench_motion import KISS, PATCHWORK, STREAM, bench_motion
from workers.lab.simulation.sensor.lidar import Lidar


@pytest.mark.integration
def test_the_steps_of_the_stream_stand_beside_its_libraries_over_the_same_frames(
    tmp_path: Path,
) -> None:
    street_log(
        tmp_path / "car-7/2026-03-02/drive.mcap", frames=12, lidar=Lidar(columns=256), seed=2
    )
    bucket = open_bucket(str(tmp_path))
    (recording,) = group_recordings(bucket.list())
    settings = MiningSettings(bucket=bucket.url, artifacts="memory://")
    timed = bench_motion(bucket, recording, settings, frames=(8, None))
    by_part = {row.part: row for row in timed.parts}
    assert timed.frames == 4
    assert {f"{STREAM}: {step}" for step in ("ground", "clusters", "registration")} <= set(by_part)
    steps = [row for row in timed.parts if row.part.startswith(f"{STREAM}: ")]
    assert sum(row.mean_ms for row in steps) == pytest.approx(by_part[STREAM].mean_ms, abs=0.1)
    floors = by_part[KISS].median_ms + by_part[PATCHWORK].median_ms
    assert timed.ratio == pytest.approx(by_part[STREAM].median_ms / floors, abs=0.01)
    assert timed.ratio_with_odometry > timed.ratio
    assert timed.memory_mib > 0
    with pytest.raises(LogUnusableError, match="has 12 frames, none from 50 on"):
        bench_motion(bucket, recording, settings, frames=(50, None))


@pytest.mark.integration
def test_bench_motion_prints_the_steps_as_json(tmp_path: Path) -> None:
    log = tmp_path / "car-7/2026-03-02/drive.mcap"
    street_log(log, frames=12, lidar=Lidar(columns=128), seed=2)
    said = subprocess.run(
        [
            *(sys.executable, "-m", "service.cli.main", "bench", "motion"),
            *(str(log), "--frames", "2", "--json"),
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    assert '"ratio"' in said.stdout
    assert '"frames":2' in said.stdout.replace(" ", "")
