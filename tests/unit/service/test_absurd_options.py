"""Every option of every verb, given what cannot be meant: one sentence, and never a trace."""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import pytest
import typer

from service.cli.main import app_of, main
from tests.unit.service.mined_state import mined_state

TEXTS: Final = (
    *("", "file", "folder", "fifo", "/dev/full", "/proc/x", "missing/deep", "a" * 5000),
    *("a\nb\x1b[2J\x9b\u202e", "b\udcff", "[red]", "s3://", "ftp://x", "tcp/127.0.0.1:99999"),
    *("nan", "-1", "9" * 30, "9999999999999d", "0::0", f"{'9' * 30}:", "{}", "postgresql://"),
)
WHOLE: Final = ("", "x", "-1", "9" * 30, "1e3", "nan")
NUMBERS: Final = ("", "x", "-1", "nan", "inf", "-inf", "1e308", "9" * 30)

WORKING: Final[dict[tuple[str, ...], list[str]]] = {
    ("run",): ["--dry-run", "--bucket", "folder"],
    ("service",): ["--bucket", "file"],
    ("worker",): ["--connect", "here"],
    ("router",): ["--listen", "here"],
    ("inspect",): ["file"],
    ("score",): ["file"],
    ("watch",): ["--connect", "here"],
    ("top",): ["--state", "state"],
    ("select",): ["--budget", "1", "--state", "state"],
    ("selection", "list"): ["--state", "state"],
    ("selection", "show"): ["week", "--state", "state"],
    ("show",): ["1", "--out", "o.png", "--state", "state"],
    ("status",): ["--state", "state"],
    ("verdict", "add"): ["1", "both", "--state", "state"],
    ("verdict", "undo"): ["--state", "state"],
    ("verdict", "list"): ["--state", "state"],
    ("agreement",): ["--state", "state"],
    ("modes",): ["--state", "state"],
    ("compare",): ["--a", "software=1", "--b", "software=2", "--state", "state"],
    ("review",): ["--state", "state", "--listen", "nowhere"],
    ("export",): ["week", "--format", "json", "--out", "written", "--state", "state"],
    ("import-labels",): ["folder", "--truth", "written", "--state", "state"],
    ("rates",): ["--state", "state"],
    ("retry",): ["--all", "--state", "state"],
    ("demo",): ["--out", "file"],
    ("simulate",): ["--out", "file"],
    ("eval", "motion"): ["file", "--truth", "folder"],
    ("eval", "semantics"): ["file", "--truth", "folder"],
    ("eval", "shards"): ["file"],
    ("bench", "pipeline"): ["file"],
    ("bench", "motion"): ["file"],
    ("bench", "networks"): ["file", "--only", "images"],
    ("bench", "ledger"): ["--folder", "missing"],
    ("bench", "fleet"): ["--folder", "missing"],
    ("bench", "failures"): ["file", "--truth", "folder"],
    ("bench", "selection"): ["folder", "--rows", "0"],
    ("bench", "overlay"): ["file"],
    ("bench", "gpu"): ["file"],
    ("bench", "loop"): ["folder", "--budgets", "x"],
    ("calibrate", "sensor"): ["file", "--out", "profile.json"],
    ("calibrate", "motion"): ["file", "--truth", "folder", "--out", "rule.json"],
    ("adapt",): ["folder", "--out", "written"],
    ("train",): ["lmnet", "--logs", "folder", "--truth", "folder", "--out", "written"],
    ("convert",): ["pandaset", "folder", "--to", "written", "--truth", "truth"],
    ("eval", "flow"): ["file", "--truth", "folder"],
    ("eval", "ground"): ["file", "--truth", "folder"],
    ("eval", "odometry"): ["file", "--truth", "folder"],
    ("plan",): ["--cars", "1", "--hours", "1"],
    ("lidarcoda", "build"): ["folder", "--out", "written"],
    ("lidarcoda", "grade"): ["folder", "--out", "written"],
    ("lidarcoda", "evaluate"): ["folder", "--out", "written", "--method", "folder"],
    ("weights", "import"): [
        *("file", "--network", "salsanext", "--config", "salsanext-semantickitti"),
        *("--out", "weights"),
    ],
    ("weights", "configs"): [],
    ("config",): [],
    ("certs",): ["authority", "--reader", "a-reader"],
    ("acl",): ["authority"],
    ("token",): ["tokens", "--name", "a-name"],
    ("audit",): ["--state", "state"],
    ("sbom",): [],
    ("parts",): [],
}
"""Arguments under which a verb ends at once, with a result or a refusal."""

LONG: Final = {
    *(("doctor",), ("bench", "simulation"), ("bench", "listing"), ("bench", "viewer")),
}
"""Verbs that work for seconds whatever they are given; they share their options with others."""

STARTS: Final = {
    *((verb, option) for verb in ("worker", "watch") for option in ("--connect",)),
    *(("router", option) for option in ("--listen",)),
    *(("service", option) for option in ("--bucket",)),
    *((verb, "--out") for verb in ("demo", "simulate")),
    *((verb, "--folder") for verb in ("bench fleet", "bench ledger")),
}
"""Options with which a verb may begin what takes long: they are given what it refuses."""

NO_START: Final = ("file", "b\udcff", "/dev/full", "/proc/x")


def commands(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Walk all verbs."""
    below = getattr(command, "commands", None)
    if not below:
        yield path, command
        return
    for name, each in below.items():
        yield from commands(each, (*path, name))


VERBS: Final = dict(commands(typer.main.get_command(app_of())))


def values(verb: tuple[str, ...], parameter: Any) -> Sequence[str]:
    """Say what a parameter is given."""
    kind = str(parameter.display_type)
    if {(verb[0], parameter.opts[0]), (" ".join(verb), parameter.opts[0])} & STARTS:
        return NO_START if parameter.opts[0] == "--out" else (*NO_START, "tcp/127.0.0.1:99999")
    return WHOLE if "int" in kind else NUMBERS if "float" in kind else TEXTS


def calls(verb: tuple[str, ...]) -> Iterator[list[str]]:
    """Yield a call for each option and value, the others as they work."""
    working = WORKING[verb]
    for parameter in VERBS[verb].params:
        if parameter.hidden or parameter.name in ("help", "log_format", "log_level"):
            continue
        if parameter.param_type_name == "argument":
            after = working[1:] if working and not working[0].startswith("-") else working
            yield from ([*verb, value, *after] for value in values(verb, parameter))
        elif getattr(parameter, "is_flag", False):
            yield [*verb, *working, parameter.opts[0]]
        else:
            yield from (
                [*verb, *working, parameter.opts[0], value] for value in values(verb, parameter)
            )


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one thing of each kind, which the verbs run in."""
    monkeypatch.chdir(tmp_path)
    mined_state(tmp_path / "state")
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("x")
    os.mkfifo(tmp_path / "fifo")
    return tmp_path


def test_every_verb_is_walked() -> None:
    assert set(VERBS) == set(WORKING) | LONG


@pytest.mark.parametrize("verb", WORKING, ids=" ".join)
def test_what_cannot_be_meant_is_answered_with_a_sentence(
    verb: tuple[str, ...], world: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong: list[str] = []
    for argv in calls(verb):
        code = main(argv)
        written = capsys.readouterr()
        said = written.err
        plain = all(char.isprintable() or char == "\n" for char in written.out + said)
        if code not in (0, 1, 2, 75) or "Traceback" in said or not plain:
            wrong.append(f"{argv}: {code}: {said[-600:]}")
        elif code and not (said.startswith(("error: ", "try again")) and said.count("\n") == 1):
            wrong.append(f"{argv}: {code}: no single sentence: {said[:600]!r}")
    assert not wrong, "\n".join(wrong[:5])
    assert (world / "file").read_text() == "x", "nothing was written over"


@pytest.mark.parametrize(
    "text",
    [
        pytest.param('state = "a\\u0000b"', id="NUL"),
        pytest.param("workers = " + "9" * 5000, id="digits"),
        pytest.param("include = " + "[" * 3000, id="brackets"),
        pytest.param("lease_s = nan", id="nan"),
        pytest.param("lease_s = 1e300", id="too long to wait"),
        pytest.param("max_attempts = " + "9" * 30, id="more than a database counts"),
        pytest.param("heartbeat_s = inf", id="inf"),
        pytest.param("bucket = 2026-13-45", id="date"),
    ],
)
def test_a_settings_file_that_cannot_be_meant_is_answered_with_a_sentence(
    text: str, world: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (world / "bad.toml").write_text(text)
    assert main(["config", "--config", "bad.toml"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert "bad.toml" in said
    assert said.count("\n") == 1


def test_a_full_disk_under_the_results_is_said(world: Path) -> None:
    root = Path(__file__).resolve().parents[3]
    with Path("/dev/full").open("w") as full:
        ran = subprocess.run(
            [sys.executable, "-m", "service.cli", "top", "--state", "state", "--json"],
            cwd=world,
            env=os.environ | {"PYTHONPATH": str(root)},
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
            check=False,
        )
    assert ran.returncode == 75
    assert ran.stderr.startswith("error: the operating system refuses: No space left on device")
    assert ran.stderr.count("\n") == 1


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == "counterpoint 0.1.0\n"
