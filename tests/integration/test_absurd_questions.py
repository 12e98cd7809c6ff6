"""Whatever is asked of a service, it answers in a sentence, and answers the next one too."""

import copy
import json
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from schemas.canonical import canonical_json, sha256
from schemas.errors import TransientError
from schemas.transport import keys
from schemas.transport.ask import PROBLEM
from schemas.transport.bus import client_session, router_session
from schemas.transport.keys import DEFAULT_ROOT as ROOT
from schemas.transport.wire import decode, encode
from schemas.work import Answer, ClaimReply, CommitRequest, FailRequest, MineLease, PlanLease
from service.api.verbs import VERBS
from service.client import ControlClient
from service.curation.status import Status
from tests.contracts.ledger_world import mined, plan_of, shard_commit
from tests.free_ports import free_endpoint
from tests.integration.daemons import Daemon
from tests.integration.postgres_server import Postgres
from tests.integration.running import until

pytestmark = pytest.mark.integration

RAW = "\0raw:"
"""Begins a value that goes into the payload as it is: what Python's JSON would not write."""

ABSURD: tuple[Any, ...] = (
    99999999999999999999,
    2**63,
    -(2**63) - 1,
    -1,
    f"{RAW}1e999",
    f"{RAW}NaN",
    f"{RAW}-Infinity",
    f"{RAW}{'9' * 5000}",
    "",
    "x" * 70_000,
    "\0",
    f'{RAW}"\\ud800"',
    None,
    [],
    ["x"] * 3,
    {"x": 1},
    f"{RAW}{'[' * 2000}{']' * 2000}",
)


class Asker:
    """One session that asks as a guest on the bus can."""

    def __init__(self, session: zenoh.Session, daemon: Daemon) -> None:
        self._session, self._daemon = session, daemon
        self.refused = 0

    def ask(self, verb: str, payload: bytes) -> bytes | None:
        """Ask once; return the answer, None for a refusal in a sentence."""
        replies = self.get(keys.control(root=ROOT, verb=verb), payload)
        assert len(replies) == 1, f"{verb}: {payload[:300]!r}\n{self._daemon.words()}"
        return replies[0]

    def get(self, key: str, payload: bytes = b"") -> list[bytes | None]:
        found: list[bytes | None] = []
        for reply in self._session.get(
            key, payload=payload, timeout=20, consolidation=zenoh.ConsolidationMode.NONE
        ):
            if reply.ok is not None:
                found.append(reply.ok.payload.to_bytes())
                continue
            assert reply.err is not None
            assert reply.err.encoding == PROBLEM, (key[:200], payload[:300])
            problem = json.loads(reply.err.payload.to_bytes())["problem"]
            assert "\n" not in problem
            assert "fault of the program" not in problem, f"{key[:200]} {payload[:300]!r} {problem}"
            self.refused += 1
            found.append(None)
        return found

    def is_well(self) -> None:
        status = self.ask("status", b"")
        assert status is not None
        assert decode(Status, status).logs
        assert self._daemon.is_running(), self._daemon.words()


@pytest.fixture(params=["sqlite", "postgresql"])
def asker(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Asker]:
    endpoint = free_endpoint()
    database: tuple[str, ...] = ()
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.mcap").write_bytes(b"never opened")
    folder = Path(tempfile.mkdtemp(prefix="postgres-"))
    postgres = None
    if request.param == "postgresql":
        postgres = Postgres(folder)
        postgres.start()
        database = ("--database", postgres.url)
    at = ("--connect", endpoint, "--bucket", str(tmp_path / "logs"))
    state = ("--state", str(tmp_path / "state"), *database)
    daemon = Daemon(tmp_path, "service", "service", *at, *state)
    try:
        with router_session([endpoint]), client_session([endpoint]) as session:
            daemon.start()
            until(lambda: _serves(endpoint), "a service")
            yield Asker(session, daemon)
            assert daemon.is_running(), daemon.words()
            assert daemon.stop() == 0, daemon.words()
    finally:
        daemon.end()
        if postgres is not None:
            postgres.stop()
        shutil.rmtree(folder, ignore_errors=True)


def _serves(endpoint: str) -> bool:
    try:
        return bool(ControlClient([endpoint], root=ROOT).status().logs)
    except TransientError:
        return False


def test_an_absurd_value_in_any_field_of_any_question_is_answered(asker: Asker) -> None:
    claim: dict[str, Any] = {"worker_id": "w", "pipeline_version": "p1"}
    plan_lease = _claimed(asker, claim)
    assert isinstance(plan_lease, PlanLease)
    plan = CommitRequest(worker_id="w", lease_id=plan_lease.lease_id, plan=plan_of("a", shards=1))
    fail = FailRequest(worker_id="w", lease_id="no such lease", error="no", permanent=True)
    scene = {"scene_id": "a/lidar/0"}
    samples: dict[str, dict[str, Any]] = {
        "claim": claim,
        "renew": {"worker_id": "w", "lease_id": plan_lease.lease_id},
        "fail": fail.model_dump(mode="json"),
        "commit": plan.model_dump(mode="json"),
        "top": {"most": 3},
        "select": {"budget": 3, "name": "week-47"},
        "selection": {"name": "week-47"},
        "scene": scene,
        "overlay": scene,
        "rates": {"by": "hour", "since_ns": 0, "until_ns": 10**18},
        "retry": {"log_ids": ["a"]},
    }
    assert samples.keys() <= VERBS.keys()
    for verb in VERBS:
        for payload in (b"", b"\xff\x00", b"null", b"[]", b"1", b"{}", b'{"x":1}'):
            asker.ask(verb, payload)
        for question in _absurd(samples.get(verb, {})):
            asker.ask(verb, question)
        asker.is_well()
    assert asker.refused > 300

    # A commit among them may have been good enough to be taken.
    answer = asker.ask("commit", encode(plan))
    assert answer is not None
    shard_lease = _claimed(asker, {"worker_id": "v", "pipeline_version": "p1"})
    assert isinstance(shard_lease, MineLease)
    records = mined(shard_lease.shard)
    commit = shard_commit(shard_lease, records, worker="v")
    sent = {**commit.model_dump(mode="json"), "records": [r.decode() for r in records.values()]}
    for change in ({"points": 2**40 + 1}, {"frames": -1}, {"lidar_topic": "/" + "x" * 300}):
        refused = asker.ask("commit", _with_record(commit, records, change))
        assert refused is not None
        assert "not a scene score" in decode(Answer, refused).problem
    too_long = _with_record(commit, records, {"reasons": ["x" * 4000] * 5})
    assert asker.ask("commit", too_long) is None
    for question in _absurd(sent):
        asker.ask("commit", question)
    asker.is_well()


@pytest.mark.parametrize("name", ["since", "most", "newest", "withdrawn"])
def test_an_absurd_parameter_of_the_history_is_answered(asker: Asker, name: str) -> None:
    every = keys.all_scenes(root=ROOT)
    for value in ("99999999999999999999", str(2**63), "9" * 5000, "-1", "", "x", "1e9", "²", "٣"):
        asker.get(f"{every}?{name}={value}")
    assert asker.refused >= 8
    asker.is_well()


def test_what_is_too_large_is_refused_before_it_is_read(asker: Asker) -> None:
    for verb in VERBS:
        assert asker.ask(verb, b" " * (VERBS[verb].most_bytes + 1)) is None, verb
    asker.is_well()


def _claimed(asker: Asker, claim: dict[str, Any]) -> Any:
    answer = asker.ask("claim", json.dumps(claim).encode())
    assert answer is not None
    return decode(ClaimReply, answer).grant


def _with_record(commit: CommitRequest, records: dict[str, bytes], change: dict[str, Any]) -> bytes:
    """The commit of a shard, its first record changed and brought along."""
    digest = commit.manifest[0].sha256
    record = canonical_json(json.loads(records[digest]) | change)
    first = commit.manifest[0].model_copy(update={"sha256": sha256(record)})
    said = commit.model_copy(update={"manifest": (first, *commit.manifest[1:])})
    return json.dumps({**said.model_dump(mode="json"), "records": [record.decode()]}).encode()


def _absurd(base: dict[str, Any]) -> Iterator[bytes]:
    """Yield the question with an absurd value in each field, one at a time."""
    for path in _paths(base):
        for value in ABSURD:
            question = copy.deepcopy(base)
            at: Any = question
            for step in path[:-1]:
                at = at[step]
            at[path[-1]] = value
            yield _payload(question)


def _paths(value: Any) -> Iterator[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for name, below in items:
        yield (name,)
        if isinstance(below, dict | list):
            yield from ((name, *rest) for rest in _paths(below))


def _payload(question: Any) -> bytes:
    written = json.dumps(question)
    for value in ABSURD:
        if isinstance(value, str) and value.startswith(RAW):
            written = written.replace(json.dumps(value), value.removeprefix(RAW))
    return written.encode()
