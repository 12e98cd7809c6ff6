"""Verbs `export` and `import-labels` on a state folder: exit codes, and one sentence for errors."""

import json
from pathlib import Path

import pytest

from service.cli.main import main
from tests.export_world import made_world, record
from tests.unit.service.exported_state import state_of_the_world
from tests.unit.service.mined_state import mined_state


@pytest.fixture
def state(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    folder = tmp_path / "state"
    mined_state(folder)
    assert main(["select", "--budget", "2", "--name", "week", "--state", str(folder)]) == 0
    capsys.readouterr()
    return folder


def exported(state: Path, out: Path, *arguments: str, form: str = "openlabel") -> int:
    options = ["--format", form, "--out", str(out), "--state", str(state)]
    return main(["export", "week", *options, *arguments])


def test_a_selection_is_exported_and_the_second_run_keeps_it(
    state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exported(state, tmp_path / "out", "--json") == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines
    assert all((tmp_path / "out" / line["place"]).stat().st_size == line["bytes"] for line in lines)
    assert exported(state, tmp_path / "out") == 0
    kept = f"0 scenes written as openlabel; {len(lines)} scene"
    assert kept in capsys.readouterr().err


def test_a_scene_without_its_overlay_is_named_and_the_exit_code_says_so(
    state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    next((state / "artifacts").rglob("*.overlay")).unlink()
    for other in (state / "artifacts").rglob("*.overlay"):
        other.unlink()
    assert exported(state, tmp_path / "out") == 3
    assert "missing: car-7/a/" in capsys.readouterr().err


def test_a_scene_whose_log_is_gone_is_named(
    state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bucket = made_world(tmp_path).bucket
    code = exported(state, tmp_path / "out", "--bucket", str(bucket), form="semantickitti")
    assert code == 3
    assert "no log car-7/a in file://" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["week", "--format", "csv"], "no format 'csv': --format is one of mcap, "),
        (["month", "--format", "json"], "no selection 'month'"),
        (["week", "--format", "cvat"], "format cvat reads the logs: name their bucket"),
    ],
)
def test_bad_input_is_one_sentence(
    state: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    said: str,
) -> None:
    options = ["--out", str(tmp_path / "out"), "--state", str(state)]
    assert main(["export", *arguments, *options]) == 1
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_finished_labels_of_scenes_of_another_state_are_truth_and_not_judged(
    state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world = made_world(tmp_path)
    world.export(world.selection(), "semantickitti", tmp_path / "labels")
    arguments = [str(tmp_path / "labels"), "--truth", str(tmp_path / "truth")]
    assert main(["import-labels", *arguments, "--state", str(state)]) == 0
    told = capsys.readouterr().err
    assert "not judged: car-7/2026-11-20/drive/" in told
    assert "8 frames of 2 scenes" in told
    assert "8 of 8 frames still have the pre-labels of the export" in told
    assert main(["import-labels", *arguments, "--state", str(state)]) == 1
    assert "--truth must be an empty folder" in capsys.readouterr().err


def test_finished_labels_become_verdicts_once_under_the_name_that_is_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world, mine = made_world(tmp_path), state_of_the_world(tmp_path / "mine")
    world.export(world.selection(), "semantickitti", tmp_path / "labels")

    def imported(name: str, *more: str) -> str:
        truth = ["--truth", str(tmp_path / name), "--state", str(mine)]
        assert main(["import-labels", str(tmp_path / "labels"), *truth, *more]) == 0
        return capsys.readouterr().err

    def verdicts() -> list[dict[str, object]]:
        assert main(["verdict", "list", "--state", str(mine), "--json"]) == 0
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    assert "verdicts of" not in imported("a")
    assert verdicts() == []
    untouched = imported("u", "--reviewer", "lab")
    assert "no verdicts of 2 scenes in which no label changed: give --confirmed" in untouched
    assert "0 verdicts of lab" in untouched
    assert verdicts() == []
    lab = ("--reviewer", "lab", "--confirmed")
    assert "2 verdicts of lab on tracks that are a reason" in imported("b", *lab)
    imported("c", *lab)
    rows = verdicts()
    assert {row["scene_id"] for row in rows} == {record(0).scene_id, record(1).scene_id}
    assert [(row["track_id"], row["verdict"], row["reviewer"]) for row in rows] == [
        (0, "supervised", "lab")
    ] * 2


def test_labels_that_leave_motion_open_say_why_tracks_are_unsure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world, mine = made_world(tmp_path), state_of_the_world(tmp_path / "mine")
    world.export(world.selection(), "semantickitti", tmp_path / "labels")
    for file in (tmp_path / "labels").rglob("*.label"):
        file.write_bytes(bytes(file.stat().st_size))  # every point unlabelled
    truth = ["--truth", str(tmp_path / "truth"), "--state", str(mine)]
    assert main(["import-labels", str(tmp_path / "labels"), *truth]) == 0
    told = capsys.readouterr().err
    assert "which stream is wrong: unsure 2" in told
    assert "2 unsure: the labels of most of their points say neither static nor moving" in told


def test_an_empty_name_of_a_reviewer_is_refused_before_anything_is_written(
    state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--truth", str(tmp_path / "truth"), "--state", str(state), "--reviewer", " "]
    assert main(["import-labels", str(tmp_path), *arguments]) == 1
    assert "--reviewer: give a name" in capsys.readouterr().err
    assert not (tmp_path / "truth").exists()
