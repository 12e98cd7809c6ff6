"""Environments of the readers: programs of others whose pins are not ours, run as processes."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any, Final

import pytest

HERE: Final = Path(__file__).resolve().parent
ENVIRONMENTS: Final = HERE.parents[1] / ".readers"
HOW: Final = {
    "labelling": "make readers",
    "fiftyone": "make fiftyone (1.2 GB with its MongoDB, so no part of CI)",
    "labelstudio": "make labelstudio (1 GB, so no part of CI)",
}
"""Environments by name: the command that makes each."""
OUTSIDE_CI: Final = ("fiftyone", "labelstudio")


def read_by(script: str, path: Path, *, environment: str = "labelling") -> Any:
    """Let a script of this folder read an export, and return what it found.

    The script runs in the environment of its reader and imports nothing of ours. It gets the path
    as its only argument and writes JSON to stdout.

    Args:
        script: Name without `.py`.
        path: File or folder of the export.
        environment: Name of the environment. In CI its absence is a failure, elsewhere a skip.
    """
    python = ENVIRONMENTS / environment / "bin" / "python"
    if not python.is_file():
        message = f"no environment of the readers in {python.parents[1]}: {HOW[environment]}"
        if os.environ.get("CI") and environment not in OUTSIDE_CI:
            pytest.fail(message)
        pytest.skip(message)
    run = subprocess.run(
        [str(python), "-P", str(HERE / f"{script}.py"), str(path)],
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert run.returncode == 0, f"{script} rejects {path}:\n{run.stderr[-4000:]}"
    return json.loads(run.stdout.splitlines()[-1])  # readers write progress, too
