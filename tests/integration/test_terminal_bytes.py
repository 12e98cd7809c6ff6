"""Names and metadata that would steer a terminal reach it as plain text, in every verb."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from schemas.score import Reason
from tests.factories import street_log
from tests.unit.service.mined_state import mined_state

pytestmark = pytest.mark.integration

ROOT = Path(__file__).resolve().parents[2]
STEERING = "\x1b]52;c;aGk=\x07\x1b[2J\x9b31m\u202e\n[red]"
"""Sets the clipboard, clears the screen, colours (C1), reverses, breaks the line, and is markup."""

IN_A_NAME = "\u200f[red]"
"""Of a file in a bucket, whose listing skips a name with control characters."""

SHOWN = r"\x1b]52;c;aGk=\x07\x1b[2J\x9b31m\u202e\n[red]"


def counterpoint(*argv: str, cwd: Path) -> subprocess.CompletedProcess[bytes]:
    """Run the real command."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "COLUMNS": "400"}
    return subprocess.run(
        [sys.executable, "-m", "service.cli", *argv],
        cwd=cwd,
        env=environment,
        capture_output=True,
        timeout=840,
        check=False,
    )


def steers(written: bytes) -> str:
    """Return the characters that a terminal would obey."""
    return "".join(
        char
        for char in written.decode("utf-8")
        if not char.isprintable() and char not in "\n\t" and char != "\r"
    )


@pytest.fixture(scope="module")
def mined(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A state whose every name and reason steers, and a log whose metadata does."""
    folder = tmp_path_factory.mktemp("steering")
    mined_state(
        folder / "state",
        log_id=f"car-7/dr{STEERING}ive",
        vehicle=f"car{STEERING}",
        software_version=f"v{STEERING}",
        reasons=(Reason(headline=f"because{STEERING}"),),
    )
    street_log(
        folder / "logs" / "car-7" / "2026-03-02" / f"dr{IN_A_NAME}ive.mcap",
        vehicle=f"car{STEERING}",
        software_version=f"v{STEERING}",
    )
    return folder


@pytest.mark.parametrize(
    "argv",
    [
        ["status"],
        ["top"],
        ["rates"],
        ["rates", "--by", "log"],
        ["rates", "--by", "version"],
        ["show", "1", "--out", "scene.png"],
        ["select", "--budget", "1"],
        ["status", "--json"],
        ["top", "--json"],
    ],
    ids=" ".join,
)
def test_no_verb_passes_on_what_steers_a_terminal(mined: Path, argv: list[str]) -> None:
    ran = counterpoint(*argv, "--state", "state", cwd=mined)
    written = ran.stdout + ran.stderr
    assert ran.returncode == 0, ran.stderr.decode()
    assert steers(written) == ""
    if "--json" not in argv:
        assert SHOWN.encode() in written, "it is shown, not left out"


def test_inspecting_a_log_passes_on_nothing_that_steers_a_terminal(mined: Path) -> None:
    (log,) = (mined / "logs").rglob("*.mcap")
    ran = counterpoint("inspect", str(log), cwd=mined)
    assert ran.returncode == 0, ran.stderr.decode()
    assert steers(ran.stdout + ran.stderr) == ""
    assert SHOWN.encode() in ran.stdout


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "call",
    [
        ["run", "--once", "--bucket", "logs", "--state", "own", "--workers", "1"],
        ["score", "--pictures", "pictures"],
    ],
    ids=lambda call: call[0],
)
def test_mining_a_log_passes_on_nothing_that_steers_a_terminal(
    mined: Path, call: list[str]
) -> None:
    (log,) = (mined / "logs").rglob("*.mcap")
    named = [str(log)] if call[0] == "score" else []
    ran = counterpoint(*call, *named, "--supervised", "recorded", cwd=mined)
    assert ran.returncode == 0, ran.stderr.decode()
    assert steers(ran.stdout + ran.stderr) == ""
    assert rb"\u200f[red]" in ran.stdout + ran.stderr


def test_an_error_about_such_a_name_is_one_plain_line(mined: Path) -> None:
    ran = counterpoint("inspect", f"no{STEERING}thing.mcap", cwd=mined)
    assert ran.returncode == 1
    assert steers(ran.stderr) == ""
    assert ran.stderr.count(b"\n") == 1
    assert SHOWN.encode() in ran.stderr


def test_on_a_terminal_no_colours_but_our_own_are_written(mined: Path) -> None:
    parent, child = pty.openpty()
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "400"}
    with subprocess.Popen(
        [sys.executable, "-m", "service.cli", "status", "--state", "state"],
        cwd=mined,
        env=environment,
        stdout=child,
        stderr=child,
    ) as process:
        os.close(child)
        written = b""
        while True:
            try:
                part = os.read(parent, 65_536)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            written += part
        process.wait(60)
    os.close(parent)
    text = written.decode("utf-8")
    assert "\x1b]" not in text
    assert "\x1b[2J" not in text
    assert "\x9b" not in text
    assert "\u202e" not in text
    assert "[red]" in text
