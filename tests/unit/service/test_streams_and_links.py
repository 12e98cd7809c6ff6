"""Closed streams, links to themselves, files in place of folders, and a verb without a verb."""

import subprocess
import sys
from pathlib import Path

import pytest

from schemas.bounds import MAX_NEWEST, MAX_SCENES_ASKED, MAX_URL
from schemas.errors import BucketRefusedError
from schemas.runtime.real_path import real_path
from schemas.transport.bucket import open_bucket, open_object
from service.cli.main import main

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("group", ["", "eval", "weights", "bench", "calibrate"])
def test_a_command_without_a_verb_prints_its_help_as_it_is(
    group: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([group] if group else []) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"Usage: counterpoint {group}".rstrip())
    assert "\\n" not in said
    assert said.count("\n") > 5


@pytest.mark.parametrize(
    "argv", [["inspect", "loop"], ["score", "loop"], ["run", "--dry-run", "--bucket", "loop"]]
)
def test_a_link_to_itself_is_named_in_a_sentence(
    argv: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    assert main(argv) == 1
    assert capsys.readouterr().err == f"error: this link points to itself: {tmp_path}/loop\n"


def test_a_link_in_the_middle_of_a_path_to_itself_is_no_such_file(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(BucketRefusedError, match="no such file"):
        open_object(str(tmp_path / "loop" / "drive.mcap"))
    assert real_path(tmp_path / "loop") == tmp_path / "loop"


def test_the_home_of_a_user_who_is_not_known_is_refused() -> None:
    with pytest.raises(BucketRefusedError, match="write the whole path"):
        open_bucket("~no-user-of-this-name/logs")


def test_settings_whose_state_is_a_link_to_itself_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("logs").mkdir()
    Path("loop").symlink_to("loop")
    for argv in (
        ["run", "--once", "--bucket", "logs", "--state", "loop"],
        ["top", "--state", "loop"],
    ):
        assert main(argv) == 1
        said = capsys.readouterr().err
        assert said.startswith("error: ")
        assert said.count("\n") == 1


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_fault(closed: str, tmp_path: Path) -> None:
    ran = subprocess.run(
        ["sh", "-c", f'exec "$0" -m service.cli --version {closed}', sys.executable],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ran.returncode == 0
    assert ran.stderr == ""
    assert ran.stdout == ("counterpoint 0.1.0\n" if closed == "2>&-" else "")


@pytest.mark.parametrize(
    ("argv", "most"),
    [
        (["top", "-n"], MAX_SCENES_ASKED),
        (["select", "--budget"], MAX_SCENES_ASKED),
        (["watch", "--connect", "here", "--history"], MAX_NEWEST),
    ],
)
def test_an_option_has_the_bound_of_the_question(
    argv: list[str], most: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*argv, str(most + 1)]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"error: Invalid value for '{argv[-1]}'")
    assert str(most) in said


def test_a_state_that_is_a_file_is_called_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("logs").mkdir()
    Path("notes.txt").write_text("x")
    assert main(["top", "--state", "notes.txt"]) == 1
    assert "this is a file, not a state folder: notes.txt" in capsys.readouterr().err
    assert main(["run", "--once", "--bucket", "logs", "--state", "notes.txt"]) == 1
    said = capsys.readouterr().err
    assert "this is a file" in said
    assert "permissions" not in said


def test_a_path_that_is_too_long_is_refused_with_its_bound(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["inspect", "file", "--bucket", "a" * (MAX_URL + 1)]) == 1
    said = capsys.readouterr().err
    assert said.endswith(f": must be text of at most {MAX_URL} characters\n")
    assert f"… {'a' * 20}" in said, "the middle of a long value is left out"
    assert f"({MAX_URL + 1:,} characters)" in said
    assert len(said) < 1_000
