"""`python -m tests.yardstick`: freezes what mining makes of nine runs, and compares with it later.

    python -m tests.yardstick freeze FILE       mine, and write what came out
    python -m tests.yardstick compare FILE      mine again, and name what differs
    python -m tests.yardstick diff FILE FILE    compare two files

Two minutes of one core. Real logs are read from the folder of `COUNTERPOINT_REFERENCE`.
"""

import sys
import tempfile
from pathlib import Path
from time import monotonic

from tests.reference_folder import reference_folder
from tests.yardstick.comparing import differences, other_texts
from tests.yardstick.frozen import Yardstick, digest_of
from tests.yardstick.runs import RUNS, mine, simulate

OK, DIFFERS, USAGE = 0, 1, 2


def measure() -> Yardstick:
    """Mine every run."""
    reference = reference_folder()
    runs = {}
    with tempfile.TemporaryDirectory(prefix="yardstick-") as folder:
        simulated = Path(folder)
        simulate(simulated)
        (log,) = (simulated / "logs").rglob("*.mcap")
        digest = digest_of(log.read_bytes())
        for run in RUNS:
            began_s = monotonic()
            runs[run.name] = tuple(mine(run, reference / "data" / "logs", simulated))
            _say(f"{run.name}: {len(runs[run.name])} scenes in {monotonic() - began_s:.0f} s")
    return Yardstick(simulated_log=digest, runs=runs)


def compare(before: Yardstick, after: Yardstick) -> int:
    """Print what differs; 1 if a value or an overlay does."""
    found = list(differences(before, after))
    for line in found:
        _say(line)
    worded = list(other_texts(before, after))
    for line in worded:
        _say(f"other words: {line}")
    scenes = sum(map(len, after.runs.values()))
    _say(f"{scenes} scenes: {len(found)} differences, {len(worded)} in other words")
    return DIFFERS if found else OK


def main(arguments: list[str]) -> int:
    """Do what the first argument says."""
    match arguments:
        case ["freeze", file]:
            Path(file).write_text(measure().model_dump_json(indent=1), encoding="utf-8")
            return OK
        case ["compare", file]:
            return compare(_read(file), measure())
        case ["diff", one, other]:
            return compare(_read(one), _read(other))
    _say(__doc__ or "")
    return USAGE


def _read(file: str) -> Yardstick:
    return Yardstick.model_validate_json(Path(file).read_text(encoding="utf-8"))


def _say(line: str) -> None:
    sys.stderr.write(f"{line}\n")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
