"""Whatever a service is asked, it answers or refuses, and lives on in bounded memory.

`python -m tests.fuzz.ask` asks thousands of questions.
"""

from pathlib import Path

import pytest

from service.api.verbs import ASKED, VERBS
from tests.fuzz.ask import MOST_MB, ask_many
from tests.fuzz.questions import RIGHT

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]

QUESTIONS = 300


def test_every_question_is_answered_or_refused(tmp_path: Path) -> None:
    report = ask_many(tmp_path, examples=QUESTIONS)
    assert not report.failures, "\n".join(report.lines())
    assert report.starts == 1
    assert report.peak_mb < MOST_MB, "\n".join(report.lines())
    assert set(ASKED) <= report.ends.keys()
    for question in RIGHT:
        ends = report.ends[question.asked]
        assert ends.get("answered"), f"no {question.asked} that is right is answered any more"
        if question.asked in VERBS:
            assert ends.get("refused"), f"no {question.asked} was wrong: the questions show nothing"
