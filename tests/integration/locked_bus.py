"""A locked system in the test's own process: authority, router with rules, service; its doors."""

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import zenoh

from schemas.errors import CounterpointError
from schemas.transport import keys
from schemas.transport.ask import UnansweredError, ask, ask_until
from schemas.transport.bucket import open_bucket
from schemas.transport.bus import client_session, router_session
from schemas.transport.locks import Locks
from schemas.transport.wire import encode
from schemas.verdict import Verdict
from schemas.work import (
    Answer,
    ClaimReply,
    ClaimRequest,
    FailRequest,
    MineLease,
    PlanLease,
    RenewRequest,
)
from service.app import Service
from service.curation.verdicts import JudgeRequest
from service.security.access_rules import access_rules
from service.security.authority import open_authority
from service.security.names import BusRole
from service.settings.config import Settings
from service.store.engine import open_store
from tests.contracts.ledger_world import World, mined, shard_commit
from tests.free_ports import free_port

ROOT: Final = keys.DEFAULT_ROOT
VERSION: Final = "p1"

CERTIFICATES: Final[dict[str, BusRole]] = {
    "router": "router",
    "service": "service",
    "miner-a": "worker",
    "miner-b": "worker",
    "reader": "reader",
    "operator": "operator",
    "gone": "worker",
}
"""Name and role of each process; `gone` is signed, and no rule knows it any more."""

ALLOWED_S: Final = 20.0
DENIED_S: Final = 1.0
"""Patience where an answer is expected, and where none is: a denied question ends at once."""


class LockedBus:
    """Router with rules of access control, and a service, each with its certificate."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.endpoint = f"tls/127.0.0.1:{free_port()}"
        authority = open_authority(folder / "authority")
        names: dict[str, list[str]] = {}
        for name, role in CERTIFICATES.items():
            authority.issue(name, role)
            if name != "gone":
                names.setdefault(role, []).append(name)
        open_authority(folder / "foreign").issue("service", "service")
        self.rules = folder / "rules.json"
        self.rules.write_text(json.dumps(access_rules(names, root=ROOT)))
        (folder / "logs").mkdir()
        for log_id in ("a", "b"):
            (folder / "logs" / f"{log_id}.mcap").write_bytes(log_id.encode())
        (folder / "state").mkdir()
        self.world = World.on(open_store(folder / "state"))
        self.settings = Settings(
            bucket=str(folder / "logs"),
            artifacts=str(folder / "overlays"),
            supervised="recorded",
            list_interval_s=0.1,
            settle_s=0.0,
            expected_versions=(VERSION,),
        )
        self._open = ExitStack()

    def locks(self, name: str, *, authority: str = "authority", rules: bool = False) -> Locks:
        at = self.folder / authority
        laid = str(self.rules) if rules else ""
        return Locks(str(at / "ca.pem"), str(at / f"{name}.pem"), str(at / f"{name}.key"), laid)

    def session(self, name: str) -> zenoh.Session:
        return client_session([self.endpoint], locks=self.locks(name))

    def start(self) -> None:
        locks = self.locks("router", rules=True)
        self._open.enter_context(router_session([self.endpoint], locks=locks))
        bus = self._open.enter_context(self.session("service"))
        bucket = open_bucket(str(self.folder / "logs"))
        self.service = self._open.enter_context(
            Service(self.settings, bus, self.world.ledger, bucket=bucket)
        )

    def close(self) -> None:
        self._open.close()
        self.world.store.close()


@contextmanager
def locked_bus(folder: Path) -> Iterator[LockedBus]:
    parts = LockedBus(folder)
    parts.start()
    try:
        yield parts
    finally:
        parts.close()


@dataclass
class Visitor:
    """One session on the bus, and what it tries.

    Attributes:
        name: Name of its certificate; it claims in this name, or in that of another.
        session: On the bus.
    """

    name: str
    session: zenoh.Session

    def own_id(self) -> str:
        return f"{self.name}{keys.OWNER_END}worker-test-0"

    def asks(
        self, verb: str, payload: bytes = b"", *, name: str = "", patience_s: float = DENIED_S
    ) -> bytes | None:
        """Ask once more until answered; None: nothing ever answers."""
        key = keys.control(root=ROOT, verb=verb)
        if name:
            key = keys.named_control(root=ROOT, verb=verb, name=name)
        try:
            if patience_s == DENIED_S:
                return ask(self.session, key, payload, timeout_s=DENIED_S)
            return ask_until(
                self.session, key, payload, stop=threading.Event(), patience_s=patience_s
            )
        except UnansweredError:
            return None
        except CounterpointError as error:
            return f"refused: {error}".encode()

    def claim(
        self, *, worker_id: str, name: str, version: str = VERSION, patience_s: float = DENIED_S
    ) -> ClaimReply | None:
        request = ClaimRequest(worker_id=worker_id, pipeline_version=version)
        reply = self.asks("claim", encode(request), name=name, patience_s=patience_s)
        if reply is None or reply.startswith(b"refused"):
            return None
        return ClaimReply.model_validate_json(reply)

    def sees(self, key: str, act: Callable[[], object]) -> bool:
        """Return true if a subscriber to a key gets what an act makes appear there."""
        seen = threading.Event()
        with self.session.declare_subscriber(key, lambda _: seen.set()):
            for _ in range(3):
                act()
                if seen.wait(0.3):
                    return True
        return False

    def history(self, key: str) -> int:
        """Count the replies to a question about a key."""
        replies = self.session.get(
            key, timeout=DENIED_S, consolidation=zenoh.ConsolidationMode.NONE
        )
        return sum(reply.ok is not None for reply in replies)


def renews(visitor: Visitor, lease: PlanLease | MineLease, *, of: str, name: str) -> bool:
    request = RenewRequest(worker_id=of, lease_id=lease.lease_id)
    return _is_ok(visitor.asks("renew", encode(request), name=name))


def fails(visitor: Visitor, lease: PlanLease | MineLease, *, of: str, name: str) -> bool:
    """Try to park the work of a lease."""
    request = FailRequest(worker_id=of, lease_id=lease.lease_id, error="rogue", permanent=True)
    return _is_ok(visitor.asks("fail", encode(request), name=name))


def commits(visitor: Visitor, lease: MineLease, *, of: str, name: str) -> bool:
    records = mined(lease.shard)
    request = shard_commit(lease, records, worker=of, sent=list(records.values()))
    return _is_ok(visitor.asks("commit", encode(request), name=name))


def judges(visitor: Visitor, scene_id: str, *, name: str) -> bool:
    request = JudgeRequest(
        key=f"door-{visitor.name}-{name}", scene_id=scene_id, reviewer="eve", verdict=Verdict.BOTH
    )
    reply = visitor.asks("judge", encode(request), name=name)
    return reply is not None and not reply.startswith(b"refused")


def _is_ok(reply: bytes | None) -> bool:
    if reply is None or reply.startswith(b"refused"):
        return False
    return Answer.model_validate_json(reply).ok
