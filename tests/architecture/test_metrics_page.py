import re
from pathlib import Path

from service.cli.metrics_page import metrics_page

PAGE = Path(__file__).resolve().parents[2] / "deploy" / "METRICS.md"


def test_every_metric_is_on_the_page_for_operators() -> None:
    assert PAGE.read_text(encoding="utf-8") == metrics_page(), (
        "a metric changed: run `python -m service.cli.metrics_page > deploy/METRICS.md`"
    )


def test_no_two_metrics_have_one_name() -> None:
    names = re.findall(r"^\| `(counterpoint_\w+)`", metrics_page(), flags=re.MULTILINE)
    assert len(names) > 40
    assert len(names) == len(set(names))
