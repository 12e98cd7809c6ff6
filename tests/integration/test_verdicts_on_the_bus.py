"""Verdicts through a running service: published, numbered, neither lost nor doubled by kills."""

import json
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Sized
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh

from schemas.errors import PermanentError, TransientError
from schemas.transport.bus import client_session
from schemas.transport.keys import DEFAULT_ROOT
from schemas.verdict import Verdict
from service.api.reader import Reader
from service.client import ControlClient
from service.curation import learned
from service.curation.listing import ScenesRequest
from service.curation.verdicts import (
    AgreementRequest,
    JudgeRequest,
    UndoRequest,
    VerdictsRequest,
)
from tests.integration.daemons import System
from tests.integration.quick_miner import SHARDS_PER_LOG
from tests.integration.running import Running, two_logs, until

pytestmark = pytest.mark.integration

VERDICTS = 200
ALL = f"{DEFAULT_ROOT}/v1/verdict/**"


def _has(found: Sized, wanted: int) -> bool:
    return len(found) >= wanted


def history(parts: Running, query: str = "") -> list[tuple[str, int, dict[str, Any]]]:
    """Key, number and content of every reply."""
    found = []
    with client_session([parts.endpoint]) as session:
        for reply in session.get(
            f"{ALL}{query}", consolidation=zenoh.ConsolidationMode.NONE, timeout=10
        ):
            assert reply.ok is not None, reply.err
            assert reply.ok.attachment is not None
            number = json.loads(reply.ok.attachment.to_bytes())["seq"]
            content = json.loads(reply.ok.payload.to_bytes())
            found.append((str(reply.ok.key_expr), number, content))
    return found


def test_verdicts_are_published_and_found_again(tmp_path: Path) -> None:
    with two_logs(tmp_path) as parts, client_session([parts.endpoint]) as session:
        live: list[dict[str, Any]] = []
        with session.declare_subscriber(
            ALL, lambda sample: live.append(json.loads(sample.payload.to_bytes()))
        ):
            parts.world.mine_all()
            client: Reader = ControlClient([parts.endpoint], root=DEFAULT_ROOT)
            scene = client.scenes(ScenesRequest(most=1)).rows[0]
            stored = client.judge(
                JudgeRequest(
                    key="one",
                    scene_id=scene.scene_id,
                    sha256=scene.sha256,
                    reviewer="ann",
                    verdict=Verdict.BOTH,
                    cause="ground",
                )
            )
            assert client.undo(UndoRequest(key="two", reviewer="ann")).ordinal == 2
            until(lambda: len(live) == 2, "both events are published")
        assert live[0] == stored.model_dump(mode="json", exclude={"is_current", "record"})
        replies = history(parts)
        assert [(number, content) for _, number, content in replies] == list(enumerate(live, 1))
        assert replies[0][0].endswith("/1")
        assert [number for _, number, _ in history(parts, "?since=1")] == [2]
        assert [number for _, number, _ in history(parts, "?most=1")] == [1]
        assert client.verdicts(VerdictsRequest()).rows == ()
        assert client.agreement(AgreementRequest()).scenes == 0
        assert "ground" in client.choices().causes


def test_a_ranking_is_learned_over_the_bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with two_logs(tmp_path) as parts:
        parts.world.mine_all()
        client = ControlClient([parts.endpoint], root=DEFAULT_ROOT)
        scenes = client.top()
        for number, scene in enumerate(scenes):
            value = Verdict.NEITHER if number % 2 else Verdict.SUPERVISED
            client.judge(
                JudgeRequest(
                    key=f"k{number}", scene_id=scene.scene_id, reviewer="ann", verdict=value
                )
            )
        with pytest.raises(PermanentError, match=f"{len(scenes)} scenes have .* 30 are needed"):
            client.top_learned()
        monkeypatch.setattr(learned, "MIN_VERDICTS", len(scenes))
        found = client.top_learned(3)
        assert found.learned is not None
        assert found.learned.effect.verdicts == len(scenes)
        assert [row.rank for row in found.scenes] == [1, 2, 3]
        assert len(found.learned.chances) == 3


def persistent(judge: Any, request: Any, *, end_s: float) -> Any:
    """Repeat a write until it is answered, as a page does."""
    while True:
        try:
            return judge(request)
        except TransientError:
            assert time.monotonic() < end_s, "the service does not come back"
            threading.Event().wait(0.1)


def test_no_acknowledged_verdict_is_lost_or_doubled_by_kills(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.mcap").write_bytes(b"never opened")
    system = System(tmp_path, str(tmp_path / "logs"))
    miner: subprocess.Popen[bytes] | None = None
    try:
        system.router.start()
        system.service.start()
        command = [sys.executable, "-m", "tests.integration.quick_miner", system.endpoint, "m"]
        miner = subprocess.Popen(command, stdin=subprocess.DEVNULL)
        client = ControlClient([system.endpoint], root=DEFAULT_ROOT)
        end_s = time.monotonic() + 120.0
        while (
            len(scenes := persistent(client.scenes, ScenesRequest(most=200), end_s=end_s).rows)
            < SHARDS_PER_LOG
        ):
            assert time.monotonic() < end_s, "nothing is mined"
        acknowledged: dict[str, int] = {}

        def review(reviewer: str) -> None:
            for number in range(VERDICTS // 2):
                request = JudgeRequest(
                    key=uuid.uuid4().hex,
                    scene_id=scenes[number % len(scenes)].scene_id,
                    reviewer=reviewer,
                    verdict=Verdict.BOTH if number % 2 else Verdict.NEITHER,
                )
                stored = persistent(client.judge, request, end_s=end_s)
                acknowledged[request.key] = stored.ordinal

        reviewers = [threading.Thread(target=review, args=(name,)) for name in ("ann", "bob")]
        for reviewer in reviewers:
            reviewer.start()
        for number, part in enumerate((system.service, system.router, system.service), 1):
            wanted = VERDICTS * number // 5
            until(partial(_has, acknowledged, wanted), "verdicts are given")
            part.restart()
        for reviewer in reviewers:
            reviewer.join(timeout=120)
        assert len(acknowledged) == VERDICTS
        request = VerdictsRequest(current=False, most=500)
        rows = persistent(client.verdicts, request, end_s=end_s).rows
        assert {row.key: row.ordinal for row in rows} == acknowledged
        assert sorted(row.ordinal for row in rows) == list(range(1, VERDICTS + 1))
    finally:
        if miner is not None:
            miner.kill()
            miner.wait()
        system.end()
