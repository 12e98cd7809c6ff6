from pathlib import Path

import pytest

from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from workers.lab.simulation.faults.plan import FailureKind, LogPlan, PlannedFailure
from workers.lab.simulation.output.fleet import FleetOptions, write_planned
from workers.lab.simulation.sensor.lidar import Lidar
from workers.score import score_recording


@pytest.mark.integration
@pytest.mark.parametrize("seed", [8, 9])
def test_the_best_scene_of_a_log_is_one_in_which_the_model_on_the_car_errs(
    tmp_path: Path, seed: int
) -> None:
    wanted = PlannedFailure(2, FailureKind.MISSED_MOVER)
    plan = LogPlan(0, seed, 4, hard=False, software_version="2026.1", failures=(wanted,))
    log = write_planned(tmp_path, plan, options=FleetOptions(lidar=Lidar()))
    (failure,) = log.planted.failures
    assert failure.kind is FailureKind.MISSED_MOVER
    bucket = open_bucket(str(tmp_path / "logs"))
    (recording,) = group_recordings(bucket.list())
    settings = MiningSettings(bucket=bucket.url, artifacts="memory://", supervised="recorded")
    scores = list(score_recording(bucket, recording, settings))
    assert len(scores) == 4
    best = max(scores, key=lambda scene: scene.score)
    assert scores.index(best) == failure.cell
