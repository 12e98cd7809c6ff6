from pathlib import Path

import pytest

from schemas.bucket import open_bucket
from schemas.recordings import group_recordings
from schemas.work import MiningSettings
from workers.score import score_recording
from workers.simulation.fleet import simulate_fleet
from workers.simulation.recorded import MistakeKind


@pytest.mark.integration
def test_the_best_scene_of_a_log_is_one_in_which_the_model_on_the_car_errs(tmp_path: Path) -> None:
    (log,) = simulate_fleet(tmp_path, logs=1, seconds=8.0, seed=7)
    assert [mistake.kind for mistake in log.mistakes] == [MistakeKind.MISSED_MOVER]
    bucket = open_bucket(str(tmp_path / "logs"))
    (recording,) = group_recordings(bucket.list())
    settings = MiningSettings(bucket=bucket.url, artifacts="memory://", supervised="recorded")
    scores = list(score_recording(bucket, recording, settings))
    assert len(scores) == 4
    best = max(scores, key=lambda scene: scene.score)
    begin_s = (best.start_ns - scores[0].start_ns) / 1e9
    end_s = (best.end_ns - scores[0].start_ns) / 1e9
    assert any(mistake.start_s < end_s and begin_s < mistake.end_s for mistake in log.mistakes)
