"""A page under a flood of requests keeps its memory bounded, and answers when it is over."""

from pathlib import Path

import pytest

from tests.fuzz.http import MOST_MB
from tests.integration.http_flood import flood

pytestmark = [pytest.mark.integration, pytest.mark.timeout(300)]

BUSY = 503


@pytest.mark.parametrize("rate", [0, 10])
def test_a_flood_of_requests_is_answered_or_refused(tmp_path: Path, rate: int) -> None:
    found = flood(tmp_path, requests=400, clients=8, rate=rate)
    assert found.deaths == 0
    assert found.peak_mb <= MOST_MB
    assert sum(found.statuses.values()) == 400
    assert not [status for status in found.statuses if status >= 500 and status != BUSY]
    assert (429 in found.statuses) == (rate > 0), found.statuses
