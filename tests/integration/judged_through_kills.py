"""Two reviewers judge the same scenes on the page while page, service and router are killed.

The long form is a command:

    python -m tests.integration.judged_through_kills --verdicts 2000 --kills 30
"""

import argparse
import re
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from schemas.errors import TransientError
from schemas.verdict import VerdictRow
from service.client import ControlClient
from service.curation.verdicts import VerdictsRequest
from tests.free_ports import free_port
from tests.integration.daemons import Daemon, System

REVIEWERS = ("ann", "bob")
END_S = 280.0
_UNDONE_EVERY = 10


@dataclass
class Tab:
    """The open page of one reviewer, which sends again whatever was not answered.

    Attributes:
        acknowledged: Number of each event that the page acknowledged, by the key of its form.
        again: Forms that were sent more than once.
    """

    url: str
    reviewer: str
    end_s: float
    acknowledged: dict[str, int] = field(default_factory=dict)
    again: int = 0

    def __post_init__(self) -> None:
        self.http = httpx.Client(base_url=self.url, headers={"accept": "application/json"})
        text = self._repeat("GET", "/agreement", headers={"accept": "text/html"}).text
        found = re.search(r'data-token="([0-9a-f]+)"', text)
        assert found is not None
        self.token = found[1]
        self._repeat("POST", "/reviewer", data={"token": self.token, "name": self.reviewer})

    def scenes(self) -> list[str]:
        rows = self._repeat("GET", "/data/scenes?most=200").json()["rows"]
        return [str(row["scene_id"]) for row in rows]

    def judge(self, scenes: list[str], verdicts: int) -> None:
        """Judge scene after scene, and take every tenth verdict back."""
        for number in range(verdicts):
            verdict = ("supervised", "neither")[number % 2]
            self._write("/verdict", scene_id=scenes[number % len(scenes)], verdict=verdict)
            if number % _UNDONE_EVERY == _UNDONE_EVERY - 1:
                self._write("/undo", scene_id=scenes[number % len(scenes)])

    def _write(self, path: str, **fields: str) -> None:
        key = uuid.uuid4().hex
        answer = self._repeat("POST", path, data={"token": self.token, "key": key} | fields)
        self.acknowledged[key] = answer.json()["stored"]["ordinal"]

    def _repeat(self, method: str, path: str, **options: Any) -> httpx.Response:
        while True:
            try:
                answer = self.http.request(method, path, timeout=20, **options)
                if answer.status_code in (200, 303):
                    return answer
                assert answer.status_code == 503, f"{answer.status_code}: {answer.text[:300]}"
            except httpx.TransportError:
                pass
            self.again += method == "POST"
            assert time.monotonic() < self.end_s, "the page does not come back"
            threading.Event().wait(0.05)


def judge_through_kills(folder: Path, *, verdicts: int, kills: int) -> dict[str, float]:
    """Judge, kill, compare what is stored with what was acknowledged; return counts.

    Raises:
        AssertionError: If an acknowledged event is missing, is stored twice, or was never sent.
    """
    begun_s = time.monotonic()
    (folder / "logs").mkdir()
    (folder / "logs" / "a.mcap").write_bytes(b"never opened")
    system, port = System(folder, str(folder / "logs")), free_port()
    listen = ("--listen", f"127.0.0.1:{port}")
    page = Daemon(
        folder, "page", "review", "--connect", system.endpoint, *listen,
        env={"NUMBA_CACHE_DIR": str(folder), "COUNTERPOINT_HTTP_RATE": "0"},
    )  # fmt: skip
    parts = (page, system.service, system.router)
    miner: subprocess.Popen[bytes] | None = None
    tabs: list[Tab] = []
    try:
        for part in parts:
            part.start()
        command = [sys.executable, "-m", "tests.integration.quick_miner", system.endpoint, "m"]
        miner = subprocess.Popen(command, stdin=subprocess.DEVNULL)
        end_s = begun_s + END_S
        tabs += [Tab(f"http://127.0.0.1:{port}", each, end_s) for each in REVIEWERS]
        while not (scenes := tabs[0].scenes()):
            assert time.monotonic() < end_s, "nothing is mined"
            threading.Event().wait(0.1)
        each = verdicts // len(tabs)
        threads = [threading.Thread(target=tab.judge, args=(scenes[:3], each)) for tab in tabs]
        for thread in threads:
            thread.start()
        for number in range(kills):
            wanted = verdicts * (number + 1) // (kills + 2)
            while _given(tabs) < wanted and any(thread.is_alive() for thread in threads):
                threading.Event().wait(0.005)
            parts[number % len(parts)].restart()
        for thread in threads:
            thread.join(END_S)
        acknowledged = {key: at for tab in tabs for key, at in tab.acknowledged.items()}
        sent = len(tabs) * (each + each // _UNDONE_EVERY)
        assert len(acknowledged) == sent, "a reviewer gave up"
        rows = _stored(system.client, end_s)
        stored = {row.key: row.ordinal for row in rows}
        assert stored == acknowledged, "what is stored is what was acknowledged"
        assert Counter(stored.values()).most_common(1)[0][1] == 1
        assert sorted(stored.values()) == list(range(1, sent + 1)), "numbers have no gap"
        return {
            "events": sent,
            "kills": kills,
            "sent again": sum(tab.again for tab in tabs),
            "seconds": round(time.monotonic() - begun_s, 1),
        }
    finally:
        for tab in tabs:
            tab.http.close()
        if miner is not None:
            miner.kill()
            miner.wait()
        page.end()
        system.end()


def _given(tabs: list[Tab]) -> int:
    return sum(len(tab.acknowledged) for tab in tabs)


def _stored(client: ControlClient, end_s: float) -> list[VerdictRow]:
    """Return every event of the ledger."""
    rows: list[VerdictRow] = []
    before: int | None = None
    while True:
        try:
            page = client.verdicts(VerdictsRequest(current=False, most=500, before=before))
        except TransientError:
            assert time.monotonic() < end_s, "the service does not come back"
            continue
        rows += page.rows
        before = page.next
        if before is None:
            return rows


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--verdicts", type=int, default=200)
    parser.add_argument("--kills", type=int, default=9)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        sys.stdout.write(
            f"{judge_through_kills(Path(name), verdicts=given.verdicts, kills=given.kills)}\n"
        )
