import json
from pathlib import Path

import pytest

from schemas.bucket import open_bucket
from schemas.recordings import group_recordings
from schemas.work import MiningSettings
from tests.factories import SMALL_LIDAR
from workers.ingest.plan import plan_recording
from workers.simulation.fleet import MISTAKES_IN_TURN, SimulatedLog, simulate_fleet

LOGS, SECONDS = 4, 4.0


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[SimulatedLog], int]:
    folder = tmp_path_factory.mktemp("fleet")
    calls: list[None] = []
    logs = simulate_fleet(
        folder,
        logs=LOGS,
        seconds=SECONDS,
        seed=3,
        lidar=SMALL_LIDAR,
        progress=lambda: calls.append(None),
    )
    return folder, logs, len(calls)


def test_a_fleet_is_a_bucket_of_logs_with_truth_beside_it(
    fleet: tuple[Path, list[SimulatedLog], int],
) -> None:
    folder, logs, calls = fleet
    recordings = group_recordings(open_bucket(str(folder / "logs")).list())
    assert {each.log_id for each in recordings} == {each.log_id for each in logs}
    assert len(recordings) == LOGS
    assert calls == sum(each.frames for each in logs) == LOGS * round(SECONDS * 10)
    for each in logs:
        assert each.truth == folder / "truth" / each.log_id
        assert len(list(each.truth.glob("[0-9]*.npz"))) == each.frames


def test_logs_say_whose_they_are_as_their_paths_do(
    fleet: tuple[Path, list[SimulatedLog], int],
) -> None:
    folder, _, _ = fleet
    bucket = open_bucket(str(folder / "logs"))
    settings = MiningSettings(bucket=bucket.url, artifacts="memory://", supervised="recorded")
    software = set()
    for recording in group_recordings(bucket.list()):
        plan = plan_recording(bucket, recording, settings)
        assert not plan.refused
        assert [plan.vehicle, plan.date] == recording.log_id.split("/")[:2]
        software.add(plan.software_version)
    assert len(software) == 2


def test_mistakes_go_round_and_some_logs_have_none(
    fleet: tuple[Path, list[SimulatedLog], int],
) -> None:
    _, logs, _ = fleet
    assert any(each.mistakes for each in logs)
    for number, each in enumerate(logs):
        assert {mistake.kind for mistake in each.mistakes} <= set(MISTAKES_IN_TURN[number % 4])
        listed = json.loads((each.truth / "mistakes.json").read_text())["mistakes"]
        assert [row["track"] for row in listed] == [mistake.track for mistake in each.mistakes]
    assert not MISTAKES_IN_TURN[2]


def test_a_fleet_whose_model_is_right_has_no_mistakes(tmp_path: Path) -> None:
    (log,) = simulate_fleet(
        tmp_path, logs=1, seconds=1.0, seed=3, mistakes=False, lidar=SMALL_LIDAR
    )
    assert log.mistakes == ()
