import json
from pathlib import Path

import pytest

from service.cli.main import main
from workers.lab.simulation.faults.plan import FailureKind, LogPlan, PlannedFailure
from workers.lab.simulation.output.fleet import FleetOptions, write_planned

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short logs; the model on the car errs in the second scene of each."""
    folder = tmp_path_factory.mktemp("fleet")
    for number, kind in enumerate((FailureKind.MISSED_MOVER, FailureKind.PARKED_CALLED_MOVING)):
        wanted = PlannedFailure(1, kind)
        plan = LogPlan(number, 7 + number, 3, False, "2026.1", failures=(wanted,))
        write_planned(folder, plan, options=FleetOptions(columns=400))
    return folder


def test_the_bench_finds_what_was_planted_and_keeps_what_it_mined(
    fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept, report = tmp_path / "kept", tmp_path / "report.html"
    arguments = ["bench", "failures", str(fleet), "--table", "planted", "--json", "--draws", "50"]
    arguments += ["--kept", str(kept), "--report", str(report), "--slip-logs", "1"]
    assert main(arguments) == 0
    (line,) = capsys.readouterr().out.splitlines()
    found = json.loads(line)
    assert (found["scenes"], found["failures"], found["unseen"]) == (6, 2, 0)
    assert found["ap"] > found["baselines"]["random"]["ap"]
    assert found["slips"]["scenes"] == 2
    assert found["natural"] is None
    assert len(list(kept.glob("*.json"))) == 3
    assert "<svg" in report.read_text()

    before = {file: file.stat().st_mtime_ns for file in kept.iterdir()}
    assert main(arguments) == 0
    assert capsys.readouterr().out.splitlines() == [line]
    assert {file: file.stat().st_mtime_ns for file in kept.iterdir()} == before


def test_a_network_is_judged_on_any_truth_beside_its_own_doubts(
    fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["bench", "failures", str(fleet / "logs"), "--truth", str(fleet / "truth")]
    arguments += ["--table", "natural", "--json", "--draws", "0", "--workers", "1"]
    assert main([*arguments, "--kept", str(tmp_path / "kept")]) == 0
    found = json.loads(capsys.readouterr().out)
    natural = found["natural"]
    assert natural["things"] > natural["failing_things"]
    assert {"entropy", "margin", "mc_dropout", "confidence"} <= set(natural["baselines"])
    assert "ap" not in found
