from pathlib import Path

import pytest

from schemas.mining import Grid, MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.factories import street_log
from workers.lab.evaluation.benchmarks.bench import WARMING_FRAMES, bench_pipeline
from workers.lab.simulation.sensor.lidar import Lidar


@pytest.mark.integration
def test_the_whole_path_stands_beside_its_floors_over_the_same_frames(tmp_path: Path) -> None:
    street_log(
        tmp_path / "car-7/2026-03-02/drive.mcap", frames=30, lidar=Lidar(columns=128), seed=2
    )
    bucket = open_bucket(str(tmp_path))
    (recording,) = group_recordings(bucket.list())
    settings = MiningSettings(
        bucket=bucket.url,
        artifacts="memory://",
        supervised="recorded",
        grid=Grid(scene_s=1.0, shard_s=10.0),
    )
    seen: list[tuple[int, int]] = []
    rows = bench_pipeline(
        bucket, recording, settings, frames=4, on_progress=lambda *done: seen.append(done)
    )
    by_part = {row.part: row for row in rows}
    floors = ("decompression", "kiss-icp", "patchwork++", "networks")
    assert [by_part[f"{floor} alone"].frames for floor in floors] == [4] * 4
    assert by_part["score"].frames == 10 - WARMING_FRAMES  # a whole scene of ten frames
    assert by_part["score"].share == 1.0
    stages = [row for row in rows if row.part.startswith("score: ")]
    assert {row.part for row in stages} >= {"score: ingest", "score: odometry"}
    assert sum(row.mean_ms for row in stages) == pytest.approx(by_part["score"].mean_ms, rel=0.1)
    assert all(row.median_ms > 0 for row in rows if not row.part.startswith("score: "))
    assert seen[0] == (0, 5)
    assert seen[-1] == (5, 5)
