from pathlib import Path

import pytest

from schemas.mining import MiningSettings
from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from tests.factories import SMALL_LIDAR
from workers.ingest.plan import plan_recording
from workers.lab.simulation.faults.fault_truth import PlantedTruth
from workers.lab.simulation.faults.plan import plan_fleet
from workers.lab.simulation.output.fleet import FleetOptions, SimulatedLog, simulate_to

SCENES = 12


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[SimulatedLog], int]:
    folder = tmp_path_factory.mktemp("fleet")
    calls: list[None] = []
    logs = simulate_to(
        str(folder),
        plan_fleet(scenes=SCENES, seed=3, share=0.25),
        options=FleetOptions(lidar=SMALL_LIDAR),
        progress=lambda: calls.append(None),
    )
    return folder, list(logs), len(calls)


def test_a_fleet_is_a_bucket_of_logs_with_truth_beside_it(
    fleet: tuple[Path, list[SimulatedLog], int],
) -> None:
    folder, logs, calls = fleet
    recordings = group_recordings(open_bucket(str(folder / "logs")).list())
    assert {each.log_id for each in recordings} == {each.log_id for each in logs}
    assert [each.frames for each in logs] == [200, 40]
    assert calls == SCENES * 20
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


def test_what_was_planted_lies_beside_the_truth(
    fleet: tuple[Path, list[SimulatedLog], int],
) -> None:
    _, logs, _ = fleet
    planted = 0
    for each in logs:
        listed = PlantedTruth.beside(each.truth)
        assert listed is not None
        assert [row.track for row in listed.failures] == [f.track for f in each.planted.failures]
        assert len(listed.disturbances) == len(each.planted.disturbances)
        for row in listed.failures:
            assert row.end_ns - row.start_ns == pytest.approx((row.end_s - row.start_s) * 1e9)
            assert row.scene * 2.0 <= row.start_s < row.end_s <= row.scene * 2.0 + 2.0
        planted += len(listed.failures) + sum(row.became is None for row in listed.redraws)
    assert planted == 3
