"""The end of a demo: the review page on a terminal, else the command that opens it."""

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from service.cli.main import main
from service.curation.status import Status
from service.demo.run import DemoResult
from service.settings.config import Settings


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """States whose page was served, by demos that mine nothing."""
    states: list[Path] = []

    def serve(settings: Settings) -> None:
        states.append(settings.state)

    nothing = DemoResult(Status(pipeline_version=""), [], [], [], frozenset())
    monkeypatch.setattr("service.demo.run.run_demo", lambda *_, **__: nothing)
    monkeypatch.setattr("service.cli.demo.serve_until_stopped", serve)
    return states


def test_without_a_terminal_it_ends_with_the_command(
    served: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--out", str(tmp_path)]) == 0
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith("look at the scenes and judge them: ")
    assert last.endswith(f"review --state {tmp_path / 'state'}")
    assert served == []


@pytest.mark.parametrize("has_extra", [True, False])
def test_on_a_terminal_it_serves_the_page(
    served: list[Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    has_extra: bool,
) -> None:
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr("service.cli.demo.has_extra", lambda: has_extra)
    assert main(["demo", "--out", str(tmp_path)]) == 0
    assert served == ([tmp_path / "state"] if has_extra else [])
    assert ("review --state" in capsys.readouterr().err) is not has_extra
