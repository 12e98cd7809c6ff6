"""`counterpoint simulate`: the same bytes for any number of processes, into folders and buckets."""

from hashlib import sha256
from pathlib import Path

import pytest

from schemas.transport.bucket import open_bucket
from schemas.transport.recordings import group_recordings
from service.cli.main import main
from tests.integration.object_store import Ceph
from workers.lab.evaluation.truth.truth import LogTruth
from workers.lab.simulation.faults.plan import FailureKind, LogPlan, PlannedFailure
from workers.lab.simulation.output.fleet import FleetOptions, simulate_to

pytestmark = pytest.mark.integration
FEW = ["--scenes", "2", "--seed", "5", "--failures", "0.5", "--columns", "64"]


def digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_one_process_and_two_write_the_same_bytes(tmp_path: Path) -> None:
    ghost = (PlannedFailure(1, FailureKind.GHOST_MOVER),)
    plans = [
        LogPlan(n, 50 + n, 2, hard=bool(n), software_version="2026.2", failures=ghost)
        for n in (0, 3)
    ]
    written = []
    for processes in (1, 2):
        out = tmp_path / str(processes)
        options = FleetOptions(columns=64)
        logs = list(simulate_to(str(out), plans, options=options, processes=processes))
        assert [log.frames for log in logs] == [40, 40]
        written.append(digests(out))
    assert written[0] == written[1]
    assert len(written[0]) > 80


def test_a_bucket_gets_what_a_folder_gets_and_the_truth_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ceph: Ceph
) -> None:
    folder = tmp_path / "fleet"
    assert main(["simulate", *FEW, "--out", str(folder)]) == 0
    name = ceph.make_bucket()
    for variable, value in ceph.environment().items():
        monkeypatch.setenv(variable, value)
    assert main(["simulate", *FEW, "--out", f"s3://{name}/week 1"]) == 0
    stored = open_bucket(f"s3://{name}/week 1")
    there = {each.key: sha256(stored.read_all(each.key)).hexdigest() for each in stored.list()}
    assert there == digests(folder)

    (recording,) = group_recordings(open_bucket(str(folder / "logs")).list())
    truth = LogTruth.beside(recording, folder / "truth")
    assert truth is not None
    assert len(truth) == 40


def test_a_lifelike_fleet_and_one_of_boxes_have_truth_and_the_lengths_asked_for(
    tmp_path: Path,
) -> None:
    few = ["--lifelike", "--log-seconds", "2:2", *FEW]
    assert main(["simulate", *few, "--out", str(tmp_path / "labels")]) == 0
    assert main(["simulate", *few, "--boxes", "--out", str(tmp_path / "boxes")]) == 0
    labels, boxes = (
        group_recordings(open_bucket(str(tmp_path / name / "logs")).list())
        for name in ("labels", "boxes")
    )
    assert len(labels) == len(boxes) == 2
    for name, recordings in (("labels", labels), ("boxes", boxes)):
        for recording in recordings:
            truth = LogTruth.beside(recording, tmp_path / name / "truth")
            assert truth is not None
            assert len(truth) == 20


@pytest.mark.parametrize("text", ["9", "8:4", "1:4", "a:b", "4:1e9", "nan:nan"])
def test_lengths_that_are_none_are_refused(
    tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", *FEW, "--log-seconds", text, "--out", str(tmp_path)]) == 1
    assert "--log-seconds" in capsys.readouterr().err
