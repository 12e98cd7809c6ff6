"""A process that makes, mutates and mines logs: a line of JSON in, a line of JSON out."""

import faulthandler
import json
import logging
import sys
import tempfile
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

import structlog

from tests.fuzz.attempt import Trial
from tests.fuzz.cases import case


def main() -> None:
    """Answer requests until the input ends."""
    faulthandler.enable()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    with (
        tempfile.TemporaryDirectory(prefix="fuzz-") as folder,
        closing(Trial(Path(folder))) as trial,
    ):
        _answer({"ready": True})
        for line in sys.stdin:
            asked = json.loads(line)
            Path("/proc/self/clear_refs").write_text("5")  # the memory's high-water mark
            _, _, draft = case(asked["seed"], asked["number"])
            outcome = trial.take(f"car-7/2026-03-02/log-{asked['number']}", draft.write())
            _answer(asdict(outcome) | {"peak_mb": _peak_mb()})


def _answer(said: dict[str, object]) -> None:
    sys.stdout.write(json.dumps(said) + "\n")
    sys.stdout.flush()


def _peak_mb() -> int:
    status = Path("/proc/self/status").read_text()
    (line,) = [each for each in status.splitlines() if each.startswith("VmHWM")]
    return int(line.split()[1]) // 1024


if __name__ == "__main__":
    main()
