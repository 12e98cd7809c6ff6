"""Answers of Label Studio, as it exports them, become verdicts on the tracks it asked about."""

import json
from pathlib import Path
from typing import Any

import pytest

from service.cli.main import main
from tests.export_world import made_world, record
from tests.readers.environment import read_by
from tests.unit.service.exported_state import state_of_the_world


@pytest.fixture
def state(tmp_path: Path) -> Path:
    return state_of_the_world(tmp_path / "state")


def answered(tmp_path: Path, *choices: str, annotator: object = 4) -> Path:
    """Write an export of Label Studio: each scene's first track has these choices in turn."""
    world = made_world(tmp_path)
    world.export(world.selection(), "labelstudio", tmp_path / "out")
    tasks = json.loads((tmp_path / "out/tasks.json").read_text())
    for number, (task, choice) in enumerate(zip(tasks, choices, strict=True)):
        task["id"] = number
        task["annotations"] = [annotation(choice, annotator), annotation("both", 9, True)]
    path = tmp_path / "project-1.json"
    path.write_text(json.dumps(tasks))
    return path


def annotation(choice: str, annotator: object, cancelled: bool = False) -> dict[str, Any]:
    result = {
        "from_name": "wrong_0",
        "to_name": "image",
        "type": "choices",
        "value": {"choices": [choice]},
    }
    return {
        "result": [result],
        "completed_by": annotator,
        "was_cancelled": cancelled,
        "lead_time": 4.5,
    }


def imported(path: Path, state: Path, *more: str) -> int:
    return main(
        ["import-labels", str(path), "--format", "labelstudio", "--state", str(state), *more]
    )


def verdicts(state: Path, capsys: pytest.CaptureFixture[str]) -> list[tuple[Any, ...]]:
    capsys.readouterr()
    assert main(["verdict", "list", "--state", str(state), "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    return sorted((r["scene_id"], r["track_id"], r["verdict"], r["reviewer"]) for r in rows)


def test_answers_are_verdicts_on_the_tracks_once(
    state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = answered(tmp_path, "supervised", "unsure")
    with_records_of(state, path)
    assert imported(path, state, "--reviewer", "lab") == 0
    assert "2 verdicts of lab from Label Studio" in capsys.readouterr().err
    expected = [
        (record(0).scene_id, 0, "supervised", "lab-4"),
        (record(1).scene_id, 0, "unsure", "lab-4"),
    ]
    assert verdicts(state, capsys) == expected
    assert imported(path, state, "--reviewer", "lab") == 0
    assert verdicts(state, capsys) == expected


def with_records_of(state: Path, path: Path) -> None:
    """Name the records that the state has: those of the world have another pipeline version."""
    from schemas.canonical import sha256
    from schemas.transport.wire import encode_scene_score
    from tests.unit.service.exported_state import mined_by_p1

    tasks = json.loads(path.read_text())
    for number, task in enumerate(tasks):
        task["data"]["record_sha256"] = sha256(encode_scene_score(mined_by_p1(record(number))))
    path.write_text(json.dumps(tasks))


@pytest.mark.timeout(300)
def test_a_server_of_label_studio_takes_the_export_and_returns_verdicts(
    state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    world = made_world(tmp_path)
    world.export(world.selection(), "labelstudio", tmp_path / "out")
    found = read_by("serve_labelstudio", tmp_path / "out", environment="labelstudio")
    assert found["pictures"] == ["image/png"] * 2
    assert found["predictions"] == 2
    path = tmp_path / "project.json"
    path.write_text(json.dumps(found["exported"]))
    with_records_of(state, path)
    assert imported(path, state, "--reviewer", "lab") == 0
    given = [(record(number).scene_id, 0, "both", "lab-1") for number in range(2)]
    assert verdicts(state, capsys) == given


@pytest.mark.parametrize(
    ("choices", "options", "said"),
    [
        (["perhaps", "both"], ["--reviewer", "lab"], "the choice 'perhaps' is no verdict"),
        (["both", "both"], [], "--reviewer is missing"),
        (["both", "both"], ["--reviewer", "lab", "--truth", "t"], "label no points"),
        (["both", "both"], ["--reviewer", "lab"], "no answer of this file is a verdict"),
    ],
)
def test_answers_that_are_no_verdicts_are_refused_in_one_sentence(
    state: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    choices: list[str],
    options: list[str],
    said: str,
) -> None:
    path = answered(tmp_path, *choices)
    capsys.readouterr()
    assert imported(path, state, *options) == 1
    told = capsys.readouterr().err
    assert said in told
    assert told.count("\n") == 1
    assert verdicts(state, capsys) == []


def test_a_file_of_something_else_is_refused(
    state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "other.json"
    for text in ("{}", '[{"data": {}}]', "[["):
        path.write_text(text)
        capsys.readouterr()
        assert imported(path, state, "--reviewer", "lab") == 1
        assert "this is no export of Label Studio as JSON" in capsys.readouterr().err
