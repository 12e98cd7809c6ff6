"""After any day that a bucket may have, the daemon knows what a fresh run would find."""

import json
import sys
from pathlib import Path
from typing import get_args

import pytest

from tests.integration.bucket_day import Kind
from tests.integration.bucket_hand import FolderHand, Hand, S3Hand
from tests.integration.day_blows import blows
from tests.integration.day_system import play
from tests.integration.evening import Evening
from tests.integration.object_store import Ceph

pytestmark = [pytest.mark.integration, pytest.mark.timeout(900)]

SEED = 1
"""Others are played by `python -m tests.integration.play_day`."""


def _say(text: str) -> None:
    sys.stderr.write(text + "\n")


def _has_really_happened(evening: Evening, hand: Hand) -> None:
    tally = evening.tally
    assert tally.changes.keys() == set(get_args(Kind))
    assert tally.kills.keys() == {*blows(hand), "subscriber"}
    assert tally.leases["expired"] > 0, "no kill has hit a miner at work"
    assert tally.superseded >= 6
    assert tally.adopted > 0
    assert tally.withdrawn >= 10
    assert evening.watched_withdrawals >= 6
    assert len(evening.fresh.records) > 10
    scores = [json.loads(record)["score"] for record in evening.fresh.records.values()]
    assert sum(score > 0 for score in scores) > 5, "nothing that could come out differently"
    assert "refused" in {log["state"] for log in evening.fresh.logs.values()}


def test_a_day_on_a_folder_ends_as_a_fresh_run_would(tmp_path: Path) -> None:
    hand = FolderHand(tmp_path / "logs")
    evening = play(tmp_path, hand, seed=SEED, say=_say)
    assert evening.differences() == []
    _has_really_happened(evening, hand)


def test_a_day_on_s3_ends_as_a_fresh_run_would(tmp_path: Path, ceph: Ceph) -> None:
    hand = S3Hand(ceph)
    evening = play(tmp_path, hand, seed=SEED, env=ceph.environment(), say=_say)
    assert evening.differences() == []
    _has_really_happened(evening, hand)
