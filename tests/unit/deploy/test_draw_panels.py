"""What draws the panels says in one sentence why it cannot, and leaves no traceback."""

import socket
import sys
from pathlib import Path

import pytest

from deploy.grafana.draw_panels import _legend_columns, main


@pytest.fixture
def nobody() -> str:
    """Return an address at which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"


def ended(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    monkeypatch.setattr(sys, "argv", ["draw_panels", *arguments])
    with pytest.raises(SystemExit) as ending:
        main()
    return ending.value.code


def test_who_does_not_answer_is_named(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    nobody: str,
    tmp_path: Path,
) -> None:
    out = tmp_path / "new" / "pictures"
    code = ended(monkeypatch, "--prometheus", nobody, "--service", nobody, "--out", str(out))
    said = capsys.readouterr().err
    assert code == 1
    assert said.startswith(f"error: {nobody} does not answer: ")
    assert said.count("\n") == 1
    assert out.is_dir()


def test_many_names_lie_in_rows_that_are_as_wide_as_the_panel() -> None:
    verbs = ["claim", "commit", "history", "overlay", "select", "status"]
    assert _legend_columns(verbs, grid_columns=8) >= len(verbs)
    long = "shard tried again, per hour"
    assert 1 < _legend_columns([*verbs, long], grid_columns=8) < len(verbs)
    assert _legend_columns([long * 9], grid_columns=8) == 1


def test_a_folder_that_cannot_be_made_is_named(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    nobody: str,
    tmp_path: Path,
) -> None:
    file = tmp_path / "file"
    file.touch()
    code = ended(monkeypatch, "--prometheus", nobody, "--out", str(file / "pictures"))
    said = capsys.readouterr().err
    assert code == 1
    assert said.startswith(f"error: cannot write pictures to {file / 'pictures'}: ")
    assert said.count("\n") == 1
