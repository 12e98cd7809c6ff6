"""The table of doors: what each role can do at each port, by real sessions and real certificates.

The same table is in SECURITY.md; a test compares the two.
"""

import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import pytest

from schemas.bounds import MAX_COMMIT_BYTES
from schemas.errors import PermanentError, TransientError
from schemas.score import MAX_RECORD_BYTES
from schemas.transport import keys
from schemas.transport.bus import client_session
from schemas.transport.locks import OPEN, Locks
from schemas.transport.wire import encode, encode_scene_score
from schemas.work import CommitRequest, MineLease, PlanLease
from service.api.messages import RetryRequest, SelectRequest, TopRequest
from service.client import ControlClient, watch_scenes
from service.curation.audit import AuditRequest, ExportedRequest
from service.security.listening import need_locked_bus
from service.settings.config import Settings
from service.store.engine import open_store
from tests.contracts.ledger_world import START_NS, World, plan_of, score_of
from tests.free_ports import free_endpoint
from tests.integration.locked_bus import (
    ALLOWED_S,
    ROOT,
    LockedBus,
    Visitor,
    commits,
    fails,
    judges,
    locked_bus,
    renews,
)
from tests.integration.running import until

pytestmark = pytest.mark.integration

VICTIM: Final = f"miner-a{keys.OWNER_END}worker-test-0"

ROLES: Final = ("revoked", "worker", "reader", "operator")
CERTIFICATE_OF: Final = {
    "revoked": "gone",
    "worker": "miner-b",
    "reader": "reader",
    "operator": "operator",
}


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LockedBus]:
    with locked_bus(tmp_path_factory.mktemp("doors")) as parts:
        yield parts


@pytest.fixture(scope="module")
def victims_lease(bus: LockedBus) -> MineLease:
    """The lease of a shard that the worker miner-a holds, got over the bus; log b is mined."""
    with bus.session("miner-a") as session:
        miner = Visitor("miner-a", session)
        until(lambda: len(bus.world.ledger.status().logs) == 2, "both logs are listed")
        while True:
            reply = miner.claim(worker_id=VICTIM, name=VICTIM, patience_s=ALLOWED_S)
            assert reply is not None, "the honest worker gets leases"
            lease = reply.grant
            if isinstance(lease, PlanLease):
                plan = plan_of(lease.recording.log_id, shards=1)
                done = CommitRequest(worker_id=VICTIM, lease_id=lease.lease_id, plan=plan)
                assert miner.asks("commit", encode(done), name=VICTIM) is not None
                continue
            assert isinstance(lease, MineLease), reply
            if lease.shard.log_id == "a":
                assert commits(miner, lease, of=VICTIM, name=VICTIM)
                continue
            return lease


def test_without_a_certificate_of_the_authority_there_is_no_session(bus: LockedBus) -> None:
    ours, theirs = bus.locks("reader"), bus.locks("service", authority="foreign")
    plain = bus.endpoint.replace("tls/", "tcp/")
    strangers: dict[str, tuple[str, Locks]] = {
        "plain tcp": (plain, OPEN),
        "of another authority, which trusts ours": (bus.endpoint, replace(theirs, ca=ours.ca)),
        "of another authority": (bus.endpoint, theirs),
    }
    for endpoint, locks in strangers.values():
        with pytest.raises(TransientError, match="no router at"):
            client_session([endpoint], locks=locks)
    with pytest.raises(PermanentError, match="needs certificates"):
        client_session([bus.endpoint])


Door = Callable[[LockedBus, Visitor, MineLease], bool]


def _top(_bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    return visitor.asks("top", encode(TopRequest(most=1))) is not None


def _follow(bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    key = keys.scene(root=ROOT, log_id="a", scene_id=f"a/lidar/{START_NS}")
    with bus.session("service") as service:
        return visitor.sees(keys.all_scenes(root=ROOT), lambda: service.put(key, b"a record"))


def _raw_records(bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    key = keys.score(root=ROOT, worker_id=VICTIM)
    with bus.session("miner-a") as miner:
        return visitor.sees(keys.all_scores(root=ROOT), lambda: miner.put(key, b"a record"))


def _history(_bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    return visitor.history(keys.all_scenes(root=ROOT)) > 0


def _hello(_bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    return visitor.asks("hello") is not None


def _claim(bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    return visitor.claim(worker_id=visitor.own_id(), name=visitor.own_id()) is not None


def _claim_as_another(bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    own = visitor.own_id()
    ways = ((VICTIM, VICTIM), (VICTIM, ""), (own, ""), (VICTIM, own), (VICTIM, "*"))
    return any(visitor.claim(worker_id=worker, name=name) is not None for worker, name in ways)


def _others_lease(_bus: LockedBus, visitor: Visitor, lease: MineLease) -> bool:
    own = visitor.own_id()
    tries = (renews, commits, fails)
    names = ((VICTIM, VICTIM), (VICTIM, ""), (VICTIM, own), (own, own))
    return any(act(visitor, lease, of=of, name=name) for act in tries for of, name in names)


def _own_records(bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    return _arrives(bus, visitor, keys.score(root=ROOT, worker_id=visitor.own_id()))


def _others_records(bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    return _arrives(bus, visitor, keys.score(root=ROOT, worker_id=VICTIM))


def _too_long_record(bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    key = keys.score(root=ROOT, worker_id=visitor.own_id())
    return _arrives(bus, visitor, key, payload=b"x" * (3 * MAX_RECORD_BYTES))


def _forged_scene(bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    key = keys.scene(root=ROOT, log_id="forged", scene_id=f"forged/lidar/{START_NS}")
    record = encode_scene_score(score_of("forged", START_NS))
    with bus.session("reader") as reader:
        watching = Visitor("reader", reader)
        return watching.sees(keys.all_scenes(root=ROOT), lambda: visitor.session.put(key, record))


def _false_service(bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    asked = threading.Event()
    key = keys.control(root=ROOT, verb="hello")
    with visitor.session.declare_queryable(key, lambda _: asked.set(), complete=True):
        with bus.session("miner-a") as miner:
            for _ in range(3):  # the router may learn of the queryable after the first request
                Visitor("miner-a", miner).asks("hello")
                if asked.wait(0.3):
                    return True
        return False


def _alive(role: str, ident: str) -> Door:
    def door(bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
        token = keys.live(root=ROOT, role=role, ident=ident or visitor.own_id())
        with visitor.session.liveliness().declare_token(token), bus.session("service") as service:
            for _ in range(3):  # the router may learn of the token after the first look
                replies = service.liveliness().get(token, timeout=0.4)
                if any(reply.ok is not None for reply in replies):
                    return True
            return False

    return door


def _named(verb: str, payload: bytes) -> Door:
    def door(_bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
        return visitor.asks(verb, payload, name=visitor.name) is not None

    return door


def _in_no_or_anothers_name(verb: str, payload: bytes) -> Door:
    def door(_bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
        other = "reader" if visitor.name == "operator" else "operator"
        names = ("", other)
        return any(visitor.asks(verb, payload, name=name) is not None for name in names)

    return door


def _judge(_bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    return judges(visitor, f"a/lidar/{START_NS}", name=visitor.name)


def _audit(_bus: LockedBus, visitor: Visitor, _lease: MineLease) -> bool:
    return visitor.asks("audit", encode(AuditRequest())) is not None


def _arrives(bus: LockedBus, visitor: Visitor, key: str, payload: bytes = b"a record") -> bool:
    with bus.session("service") as service:
        return Visitor("service", service).sees(key, lambda: visitor.session.put(key, payload))


SELECT: Final = encode(SelectRequest(budget=1))
EXPORTED: Final = encode(ExportedRequest(selection="week", form="mcap", scenes=1))

DOORS: Final[dict[str, tuple[Door, frozenset[str]]]] = {
    "ask for the ranking and other reading verbs": (_top, frozenset({"reader", "operator"})),
    "follow published scenes": (_follow, frozenset({"reader", "operator"})),
    "ask for the history of scenes": (_history, frozenset({"reader", "operator"})),
    "see raw records of workers": (_raw_records, frozenset()),
    "learn the mining settings (`hello`)": (_hello, frozenset({"worker"})),
    "take a lease under its own name": (_claim, frozenset({"worker"})),
    "take a lease under another name, or none": (_claim_as_another, frozenset()),
    "renew, commit or park the lease of another": (_others_lease, frozenset()),
    "put a record under its own name": (_own_records, frozenset({"worker"})),
    "put a record under another name": (_others_records, frozenset()),
    "put a record that is too long": (_too_long_record, frozenset()),
    "publish a scene": (_forged_scene, frozenset()),
    "answer in place of the service": (_false_service, frozenset()),
    "be alive as a worker of its own name": (_alive("worker", ""), frozenset({"worker"})),
    "be alive as another worker": (_alive("worker", VICTIM), frozenset()),
    "be alive as a service": (_alive("service", "rogue"), frozenset()),
    "select": (_named("select", SELECT), frozenset({"operator"})),
    "judge": (_judge, frozenset({"operator"})),
    "retry": (_named("retry", encode(RetryRequest())), frozenset({"operator"})),
    "export": (_named("exported", EXPORTED), frozenset({"reader", "operator"})),
    "select under another name, or none": (
        _in_no_or_anothers_name("select", SELECT),
        frozenset(),
    ),
    "read the audit log": (_audit, frozenset({"operator"})),
}
"""What is tried at the port of the router, how, and who may."""


@pytest.mark.parametrize("role", ROLES)
def test_each_door_opens_to_those_whom_the_table_names(
    bus: LockedBus, victims_lease: MineLease, role: str
) -> None:
    name = CERTIFICATE_OF[role]
    before = bus.world.ledger.status()
    with bus.session(name) as session:
        visitor = Visitor(name, session)
        if role == "worker":  # until the service is known to this session
            until(lambda: _hello(bus, visitor, victims_lease), "the service answers a worker")
        elif role != "revoked":
            until(lambda: _top(bus, visitor, victims_lease), "the service answers a reader")
        wrong = {
            door: allowed
            for door, (tries, who) in DOORS.items()
            if (allowed := tries(bus, visitor, victims_lease)) is not (role in who)
        }
    assert wrong == {}
    after = bus.world.ledger.status()
    assert (after.parked, after.scenes) == (before.parked, before.scenes)


def test_a_worker_of_a_version_that_no_one_expects_gets_no_work(
    bus: LockedBus, victims_lease: MineLease
) -> None:
    with bus.session("miner-b") as session:
        rogue = Visitor("miner-b", session)
        own = rogue.own_id()
        until(lambda: rogue.claim(worker_id=own, name=own) is not None, "the service answers")
        reply = rogue.claim(worker_id=own, name=own, version="p2")
        assert reply is not None
        assert reply.grant.kind == "nothing"
        assert "pipeline version p2 is not expected" in reply.grant.problem
    assert bus.world.ledger.pipeline_versions() == ["p1"]


def test_the_client_and_its_name_in_the_audit_log(bus: LockedBus, victims_lease: MineLease) -> None:
    operator = ControlClient([bus.endpoint], root=ROOT, locks=bus.locks("operator"))
    selection = operator.select(budget=1, name="of-the-client")
    rows = operator.audit(AuditRequest(most=5)).rows
    assert (rows[0].what, rows[0].name, rows[0].via) == ("select", "operator", "bus")
    assert selection.name in rows[0].detail
    assert all(row.is_whole for row in rows)
    reader = ControlClient([bus.endpoint], root=ROOT, locks=bus.locks("reader"))
    assert reader.top(most=1)
    with pytest.raises(TransientError, match="may not ask"):
        reader.select(budget=1)
    scenes = watch_scenes([bus.endpoint], root=ROOT, locks=bus.locks("reader"), wait=False)
    assert next(iter(scenes)).seq == 1


def test_beyond_the_loopback_a_router_needs_locks_unless_it_is_written() -> None:
    everywhere = "tcp/0.0.0.0:7447"
    with pytest.raises(PermanentError, match="without TLS"):
        need_locked_bus(Settings(), listens=[everywhere])
    need_locked_bus(Settings(insecure=True), listens=[everywhere])
    need_locked_bus(Settings(), listens=[free_endpoint()])
    with pytest.raises(PermanentError, match="without certificates"):
        need_locked_bus(Settings(), listens=["tls/0.0.0.0:7447"])
    with pytest.raises(PermanentError, match="joins a router beyond this machine"):
        need_locked_bus(Settings(), connects=["tcp/router:7447"])


def test_the_command_refuses_to_listen_for_all_and_says_how_to_lock(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "service.cli.main", "router", "--listen", "tcp/0.0.0.0:7447"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 1
    assert "counterpoint certs" in ended.stderr
    assert "insecure = true" in ended.stderr


def test_an_act_and_its_row_are_stored_together_or_not_at_all(tmp_path: Path) -> None:
    """Kill a process in the transaction of a selection: neither it nor its row is there."""
    program = (
        "import os, sys, pathlib\n"
        "from service.store import audit\n"
        "from service.store.engine import open_store\n"
        "from tests.contracts.ledger_world import World\n"
        "world = World.on(open_store(pathlib.Path(sys.argv[1])))\n"
        "world.ledger.selections.save('kept', budget=1, scenes=())\n"
        "record = audit.record\n"
        "def die(*args, **how):\n"
        "    record(*args, **how)\n"
        "    os.kill(os.getpid(), 9)\n"
        "audit.record = die\n"
        "world.ledger.selections.save('lost', budget=1, scenes=())\n"
    )
    ended = subprocess.run([sys.executable, "-c", program, str(tmp_path)], timeout=60, check=False)
    assert ended.returncode == -9
    ledger = World.on(open_store(tmp_path)).ledger
    assert [each.name for each in ledger.selections.listed()] == ["kept"]
    (row,) = ledger.audit_log.page(AuditRequest())
    assert (row.what, row.is_whole) == ("select", True)
    assert "kept" in row.detail


def test_the_page_on_security_has_this_table() -> None:
    page = Path("SECURITY.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| ([^|]+?) \| (yes|no) \| .*\|$", page, re.M))
    for door, (_, who) in DOORS.items():
        marks = " | ".join(
            "yes" if role in who else "no" for role in ("worker", "reader", "operator")
        )
        assert f"| {door} | no | {marks} |" in page, door
    assert len(rows) >= len(DOORS)
    assert MAX_COMMIT_BYTES > MAX_RECORD_BYTES
