"""A log whose recorded labels nobody judges says so."""

from pathlib import Path

import pytest

from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from service.cli.main import main
from tests.factories import street_log
from workers.ingest.plan import plan_recording
from workers.lab.simulation.output.write import LABEL_TOPIC, LIDAR_TOPIC, RecordedAs
from workers.worker.logging import log_unread_labels


@pytest.mark.parametrize(
    ("recorded_as", "supervised", "told"),
    [
        pytest.param("fields", "salsanext-lmnet", [LIDAR_TOPIC], id="in the lidar's own clouds"),
        pytest.param("topic", "salsanext:ground", [LABEL_TOPIC], id="on their own topic"),
        pytest.param("nothing", "salsanext-lmnet", [], id="none there"),
        pytest.param("topic", "recorded", [], id="they are judged"),
        pytest.param("topic", "recorded:ground", [], id="they are judged, of the ground"),
    ],
)
def test_the_topic_of_labels_that_are_not_judged_is_told(
    recorded_as: RecordedAs, supervised: str, told: list[str], tmp_path: Path
) -> None:
    street_log(tmp_path / "drive.mcap", frames=12, recorded_as=recorded_as)
    bucket = open_bucket(str(tmp_path))
    (recording,) = group_recordings(bucket.list())
    settings = MiningSettings(bucket=bucket.url, artifacts="memory://", supervised=supervised)
    heard: list[str] = []
    plan = plan_recording(bucket, recording, settings, on_unread_labels=heard.append)
    assert not plan.refused
    assert heard == told


def test_score_names_what_it_judged_and_hints_at_what_it_did_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(street_log(tmp_path / "drive.mcap", frames=12))
    hint = f"this log has recorded labels on {LIDAR_TOPIC}; compare them by --supervised recorded\n"
    assert main(["score", log]) == 0
    said = capsys.readouterr().err
    assert hint in said
    assert "streams: supervised stream salsanext-lmnet@" in said
    assert main(["score", log, "--supervised", "recorded"]) == 0
    said = capsys.readouterr().err
    assert "has recorded labels" not in said
    assert "streams: supervised stream recorded@" in said


def test_a_worker_logs_the_hint(capsys: pytest.CaptureFixture[str]) -> None:
    log_unread_labels([LIDAR_TOPIC])
    said = capsys.readouterr()
    assert "compare them by --supervised recorded" in said.out + said.err
    assert LIDAR_TOPIC in said.out + said.err
