"""Some hundred odd requests to the real pages: each is answered, by what the description says."""

from pathlib import Path

import pytest

from tests.fuzz.http import MOST_MB, ask_pages

pytestmark = [pytest.mark.integration, pytest.mark.timeout(600)]


def test_no_request_crashes_hangs_or_fills_a_page(tmp_path: Path) -> None:
    report = ask_pages(tmp_path, examples=300)
    assert report.count >= 300
    assert report.failures == {}, "\n".join(report.lines())
    assert max(report.peak_mb.values()) <= MOST_MB
