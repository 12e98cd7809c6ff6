"""Asks a real service thousands of questions: `python -m tests.fuzz.ask --examples 2000`.

The questions are the same in every run: made by hypothesis from seeds.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Final

from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.fuzz.asked_service import AskedService, Report, asked_service
from tests.fuzz.questions import EACH, RIGHT, WRONG, Question, questions

MOST_MB = 300
"""Memory of a service, whatever is asked of it."""

PART: Final = 500
"""Requests of one seed."""


def main() -> int:
    """Ask, and say how it went; 1 if a question was neither answered nor refused."""
    asked = argparse.ArgumentParser(prog="python -m tests.fuzz.ask")
    asked.add_argument("--examples", type=int, default=2000, help="how many questions")
    how = asked.parse_args()
    with tempfile.TemporaryDirectory(prefix="asked-") as folder:
        report = ask_many(Path(folder), examples=how.examples)
    for line in report.lines():
        sys.stdout.write(line + "\n")
    return int(bool(report.failures) or report.peak_mb > MOST_MB)


def ask_many(folder: Path, *, examples: int) -> Report:
    """Ask so many questions of a service, and then the ones that are right.

    Args:
        folder: For its state and logs.
        examples: How many.
    """
    with asked_service(folder) as service:
        _ask(service, examples)
        for question in (*WRONG, *EACH, *RIGHT):
            service.ask(question)
        return service.report


def _ask(service: AskedService, examples: int) -> None:
    """Ask in parts: hypothesis remembers every question of a part, large ones too."""
    for part, first in enumerate(range(0, examples, PART)):
        _ask_part(service, min(PART, examples - first), part)


def _ask_part(service: AskedService, examples: int, part: int) -> None:
    @seed(part)
    @settings(
        max_examples=examples,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(questions())
    def each(question: Question) -> None:
        service.ask(question)

    each()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
