"""A short flood of every verb and of forged records, against a service with two honest miners."""

from pathlib import Path

import pytest

from service.api.request_queue import MOST_WAITING_BYTES
from tests.benchmark.flood import flood

pytestmark = pytest.mark.integration

QUESTIONS = 4_000

MIB = 2**20


@pytest.mark.parametrize("locked", [False, True], ids=["no locks", "locked"])
def test_a_flood_ends_answered_forges_nothing_and_stops_no_miner(
    tmp_path: Path, locked: bool
) -> None:
    found = flood(
        tmp_path,
        questions=QUESTIONS,
        forged=800,
        clients=2,
        locked=locked,
        elsewhere=False,
        calm_s=3.0,
    )
    assert sum(found.ends.values()) == QUESTIONS
    assert found.ends["refused"] > 0
    if locked:
        assert found.ends["left alone"] > 0, "the router denies a reader what workers ask"
    else:
        assert found.ends.get("left alone", 0) == 0
    assert found.foreign == 0
    assert min(found.calm, found.flooded, found.after) > 0
    before, most, _ = found.memory_mib
    two_queues = 2 * MOST_WAITING_BYTES / MIB
    assert most < before + 3 * two_queues, "the queues, and what their messages become"
