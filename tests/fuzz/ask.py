"""Asks a real service thousands of questions: `python -m tests.fuzz.ask --examples 2000`.

The questions are the same in every run: made by hypothesis from seeds.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from tests.fuzz.asked_service import Report, asked_service
from tests.fuzz.parts import run_parts
from tests.fuzz.questions import EACH, RIGHT, WRONG, questions

MOST_MB = 300
"""Memory of a service, whatever is asked of it."""


def main() -> int:
    """Ask, and say how it went; 1 if a question was neither answered nor refused."""
    asked = argparse.ArgumentParser(prog="python -m tests.fuzz.ask")
    asked.add_argument("--examples", type=int, default=2000, help="how many questions")
    asked.add_argument("--seed", type=int, default=0, help="of the first part")
    how = asked.parse_args()
    with tempfile.TemporaryDirectory(prefix="asked-") as folder:
        report = ask_many(Path(folder), examples=how.examples, first_seed=how.seed)
    for line in report.lines():
        sys.stdout.write(line + "\n")
    return int(bool(report.failures) or report.peak_mb > MOST_MB)


def ask_many(folder: Path, *, examples: int, first_seed: int = 0) -> Report:
    """Ask so many questions of a service, and then the ones that are right.

    Args:
        folder: For its state and logs.
        examples: How many.
        first_seed: Seed of the first part.
    """
    with asked_service(folder) as service:
        run_parts(questions(), service.ask, examples=examples, first_seed=first_seed)
        for question in (*WRONG, *EACH, *RIGHT):
            service.ask(question)
        return service.report


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
