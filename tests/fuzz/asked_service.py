"""A real service with a ledger that holds something, which is asked and looked after."""

import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import zenoh

from schemas.problem import Problem
from schemas.transport import keys
from schemas.transport.ask import PROBLEM
from schemas.transport.bus import client_session
from schemas.transport.keys import DEFAULT_ROOT as ROOT
from schemas.transport.wire import decode, encode
from schemas.work import (
    Answer,
    ClaimReply,
    ClaimRequest,
    CommitRequest,
    MineLease,
    NothingToDo,
    PlanLease,
)
from tests.contracts.ledger_world import mined, plan_of, shard_commit
from tests.free_ports import free_endpoint
from tests.fuzz.questions import Question, payload_of
from tests.integration.daemons import Daemon

LOGS: Final = 400
MINED: Final = 6
"""Leases that are finished before anything is asked, so that there are scenes."""

PATIENCE_S: Final = 20.0
"""For an answer; the machine may be busy with other tests."""

MOST_PROBLEM: Final = 10_000
"""Characters of a sentence that says what is wrong with a question."""

ENDS_WITHIN_S: Final = 8.0
"""A service that a question ends needs a while: another question must not be blamed for it."""

VERSION: Final = "p1"


@dataclass(slots=True)
class Report:
    """How questions ended.

    Attributes:
        ends: Verb to how often it ended how.
        failures: What went wrong to the questions it went wrong with.
        slowest_s: The longest wait for an answer.
        slowest: Whose.
        start_mb: Most memory of the service before the first question.
        peak_mb: Most memory that the service held.
        peak: At which question.
        starts: How often the service had to be started.
    """

    ends: dict[str, dict[str, int]] = field(default_factory=dict)
    failures: dict[str, list[str]] = field(default_factory=dict)
    slowest_s: float = 0.0
    slowest: str = ""
    start_mb: int = 0
    peak_mb: int = 0
    peak: str = ""
    starts: int = 0

    def lines(self) -> Iterator[str]:
        """Tell it to a person."""
        kinds = ("answered", "refused", "try again", "failed")
        yield f"{'asked':12s}" + "".join(f"{kind:>11s}" for kind in kinds)
        for asked, counts in sorted(self.ends.items()):
            yield f"{asked:12s}" + "".join(f"{counts.get(kind, 0):11d}" for kind in kinds)
        yield f"slowest answer {self.slowest_s:.2f} s, {self.slowest}"
        yield f"memory of the service: {self.start_mb} MB before the first question"
        yield f"at most {self.peak_mb} MB, at {self.peak}"
        yield f"starts of the service: {self.starts}"
        yield f"failures: {sum(map(len, self.failures.values()))} in {len(self.failures)} places"
        for place, found in sorted(self.failures.items(), key=lambda item: -len(item[1])):
            yield f"  {len(found):4d}  {place}"
            yield f"        first: {found[0]}"


@contextmanager
def asked_service(folder: Path) -> Iterator["AskedService"]:
    """Start a service, and end it.

    Args:
        folder: For its state and logs.
    """
    service = AskedService(folder)
    try:
        service.start()
        yield service
    finally:
        service.end()


class AskedService:
    """Router and service as processes, and a session that asks."""

    def __init__(self, folder: Path) -> None:
        logs = folder / "logs"
        logs.mkdir()
        for number in range(LOGS):
            (logs / f"log-{number:03d}.mcap").write_bytes(b"never opened")
        self.endpoint = free_endpoint()
        at = ("--connect", self.endpoint)
        self.router = Daemon(folder, "router", "router", "--listen", self.endpoint)
        env = {
            "COUNTERPOINT_LIST_INTERVAL_S": "1",
            "COUNTERPOINT_LEASE_S": "600",
            "COUNTERPOINT_SUPERVISED": "recorded",
        }
        self.service = Daemon(
            folder,
            "service",
            *("service", "--bucket", str(logs), "--state", str(folder / "state"), *at),
            env=env,
        )
        self.report = Report()
        self._lease: PlanLease | MineLease | None = None
        self._session: zenoh.Session | None = None
        self._scene = "log-000/lidar/1700000000000000000"

    def start(self) -> None:
        """Start both, and have some scenes mined."""
        self.router.start()
        end_s = time.monotonic() + 60
        while self._session is None:
            try:
                self._session = client_session([self.endpoint])
            except Exception:  # noqa: BLE001  # there is no router yet
                assert time.monotonic() < end_s, self.router.words()
                time.sleep(0.1)
        self._start_service()
        for _ in range(MINED):
            self._finish_one()
        self._look_at_memory("the start")
        self.report.start_mb = self.report.peak_mb

    def end(self) -> None:
        """End all of it."""
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]
        self.service.end()
        self.router.end()

    def ask(self, question: Question) -> None:
        """Ask, and note how it ended; a service that has ended is started again."""
        payload = self._payload(question)
        began_s = time.monotonic()
        end, words = self._asked(question, payload)
        seconds = time.monotonic() - began_s
        counts = self.report.ends.setdefault(question.asked, {})
        ended = self._ended_within(ENDS_WITHIN_S if end == "failed" else 0.0)
        if end == "failed" or ended is not None:
            end = "failed"
            place = f"{words}; {self._last_error()}"
            if ended is not None:
                place += f"; the service ends with {ended}"
            self.report.failures.setdefault(place, []).append(str(question))
        counts[end] = counts.get(end, 0) + 1
        if seconds > self.report.slowest_s:
            self.report.slowest_s, self.report.slowest = seconds, str(question)
        if question.asked in ("commit", "fail", "renew"):
            self._lease = None
        self._look_at_memory(question)
        if ended is not None:
            self._start_service()

    def _payload(self, question: Question) -> bytes:
        base = question.base
        if question.asked in ("commit", "fail", "renew"):
            self._lease = self._lease or self._claimed()
        if base == "$COMMIT":
            base = self._right_commit()
        payload = payload_of(base, question.spoilt, question.damage)
        for name, value in self._known().items():
            payload = payload.replace(name.encode(), value.encode())
        return payload

    def _known(self) -> dict[str, str]:
        lease = self._lease
        return {
            "$LEASE": "none" if lease is None else lease.lease_id,
            "$LOG": "log-000" if lease is None else lease.recording.log_id,
            "$SCENE": self._scene,
            "$WORKER": "guest",
            "$VERSION": VERSION,
        }

    def _asked(self, question: Question, payload: bytes) -> tuple[str, str]:
        assert self._session is not None
        selector = self._key(question) + (f"?{question.parameters}" if question.parameters else "")
        replies = 0
        for reply in self._session.get(
            selector,
            payload=payload,
            timeout=PATIENCE_S,
            target=zenoh.QueryTarget.BEST_MATCHING,
            consolidation=zenoh.ConsolidationMode.NONE,
        ):
            replies += 1
            if reply.err is None:
                continue
            if reply.err.encoding != PROBLEM:
                return "failed", f"no answer within {PATIENCE_S:g} s"
            problem = decode(Problem, reply.err.payload.to_bytes())
            if not problem.problem or len(problem.problem) > MOST_PROBLEM:
                return "failed", f"a sentence of {len(problem.problem)} characters"
            return ("try again" if problem.transient else "refused"), problem.problem
        may_be_empty = question.asked in ("history", "selected", "cache")
        return ("answered", "") if replies or may_be_empty else ("failed", "no reply at all")

    def _key(self, question: Question) -> str:
        match question.asked:
            case "history":
                return keys.all_scenes(root=ROOT)
            case "selected":
                return keys.all_selected(root=ROOT)
            case "cache":
                return keys.scene_cache(root=ROOT)
            case verb:
                return keys.control(root=ROOT, verb=verb)

    def _start_service(self) -> None:
        self.service.start()
        self.report.starts += 1
        end_s = time.monotonic() + 60
        while self._ask_plainly("about", b"") is None:
            assert time.monotonic() < end_s, self.service.words()
            time.sleep(0.05)

    def _claimed(self) -> PlanLease | MineLease | None:
        request = ClaimRequest(worker_id="guest", pipeline_version=VERSION)
        answer = self._ask_plainly("claim", encode(request))
        grant = None if answer is None else decode(ClaimReply, answer).grant
        return None if isinstance(grant, NothingToDo) else grant

    def _finish_one(self) -> None:
        self._lease = self._claimed()
        commit = self._right_commit()
        answer = self._ask_plainly("commit", encode(CommitRequest.model_validate(commit)))
        assert answer is not None, self.service.words()
        assert decode(Answer, answer).ok, answer
        if commit["manifest"]:
            self._scene = commit["manifest"][0]["scene_id"]
        self._lease = None

    def _right_commit(self) -> dict[str, Any]:
        lease = self._lease
        if isinstance(lease, MineLease):
            records = mined(lease.shard, lease.recording)
            commit = shard_commit(lease, records, worker="guest", sent=list(records.values()))
        else:
            log_id = "log-000" if lease is None else lease.recording.log_id
            held = "none" if lease is None else lease.lease_id
            commit = CommitRequest(worker_id="guest", lease_id=held, plan=plan_of(log_id))
        laid_out: dict[str, Any] = commit.model_dump(mode="json")
        return laid_out

    def _ask_plainly(self, verb: Any, payload: bytes) -> bytes | None:
        assert self._session is not None
        key = keys.control(root=ROOT, verb=verb)
        for reply in self._session.get(key, payload=payload, timeout=PATIENCE_S):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
        return None

    def _ended_within(self, seconds: float) -> int | None:
        """Wait so long for the service to end by itself; return with what it did."""
        end_s = time.monotonic() + seconds
        while (ended := self.service.ended()) is None and time.monotonic() < end_s:
            time.sleep(0.05)
        return ended

    def _look_at_memory(self, when: Question | str) -> None:
        try:
            status = Path(f"/proc/{self.service.pid}/status").read_text()
        except OSError:
            return
        found = re.search(r"VmHWM:\s+(\d+) kB", status)
        if found is not None and int(found[1]) // 1024 > self.report.peak_mb:
            self.report.peak_mb = int(found[1]) // 1024
            self.report.peak = str(when)

    def _last_error(self) -> str:
        """The last error in the log of the service, numbers left out."""
        found = re.findall(
            r"^\s*([\w.]*(?:Error|Exception|Panic\w*): .*)$", self.service.said(), re.M
        )
        frames = re.findall(
            r'File "[^"]*/((?:service|schemas)/[^"]+)", line (\d+)', self.service.said()
        )
        where = f"{frames[-1][0]}:{frames[-1][1]}" if frames else "nowhere"
        return f"{re.sub(r'[0-9]+', 'N', found[-1])[:160]} at {where}" if found else "nothing said"
