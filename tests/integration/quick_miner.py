"""A worker's loop without the mining: what a storm of kills is let loose on.

Leases, publishing and commits are the product's; plans and records are made up, the same each time.
"""

import os
import signal
import sys
from pathlib import Path
from threading import Event

import zenoh

from schemas.runtime.process import stop_on_signals
from schemas.runtime.retry import StoppedError
from schemas.transport import keys
from schemas.transport.bus import client_session, recoverable_publisher
from schemas.transport.locks import OPEN, Locks
from schemas.work import CommitRequest, MineLease, NothingToDo, PlanLease
from tests.contracts.ledger_world import manifest_of, mined, plan_of, shard_commit
from workers.worker.lease import LeaseKeeper, Leases

SHARDS_PER_LOG = 8


def main(
    endpoint: str, worker_id: str, dies_of: str = "", record_s: str = "0.02", authority: str = ""
) -> None:
    """Work until told to stop.

    Args:
        endpoint: Of a router; commas for several.
        worker_id: Of this miner.
        dies_of: Kills itself in the lease of a shard `LOG:INDEX`, or in `each` lease.
        record_s: How long each record takes, seconds.
        authority: Folder of an authority, with a certificate of the miner's name; empty: no locks.
    """
    locks = locks_of(Path(authority), worker_id.partition(keys.OWNER_END)[0]) if authority else OPEN
    at = endpoint.split(",")
    with stop_on_signals() as stop, client_session(at, stop=stop, locks=locks) as session:
        leases = Leases(
            session, root=keys.DEFAULT_ROOT, worker_id=worker_id, is_named=bool(authority)
        )
        while not stop.is_set():
            try:
                _next(session, leases, stop, dies_of, float(record_s))
            except StoppedError:
                return


def locks_of(authority: Path, name: str) -> Locks:
    """Return the locks of a process by the name in its certificate."""
    return Locks(*(str(authority / each) for each in ("ca.pem", f"{name}.pem", f"{name}.key")))


def _next(
    session: zenoh.Session, leases: Leases, stop: Event, dies_of: str, record_s: float
) -> None:
    lease = leases.claim("p1", stop=stop).grant
    if isinstance(lease, NothingToDo):
        stop.wait(0.1)
        return
    if dies_of in ("each", _name(lease)):
        os.kill(os.getpid(), signal.SIGKILL)
    with LeaseKeeper(leases, lease, stop=stop, drain_s=2.0) as keeper:
        if isinstance(lease, PlanLease):
            plan = plan_of(lease.recording.log_id, shards=SHARDS_PER_LOG)
            request = CommitRequest(worker_id=leases.worker_id, lease_id=lease.lease_id, plan=plan)
            leases.commit(request, stop=keeper.drained)
        else:
            _mine(session, leases, lease, keeper, record_s)


def _name(lease: PlanLease | MineLease) -> str:
    return f"{lease.shard.log_id}:{lease.shard.index}" if isinstance(lease, MineLease) else "plan"


def _mine(
    session: zenoh.Session,
    leases: Leases,
    lease: MineLease,
    keeper: LeaseKeeper,
    record_s: float,
) -> None:
    records = mined(lease.shard)
    by_scene = {entry.scene_id: records[entry.sha256] for entry in manifest_of(records)}
    key = keys.score(root=keys.DEFAULT_ROOT, worker_id=leases.worker_id)
    with recoverable_publisher(session, key) as publisher:
        for record in records.values():
            keeper.over.wait(record_s)  # so that a kill may come between two records
            publisher.put(record)
        missing: tuple[str, ...] = ()
        while True:
            sent = [by_scene[scene_id] for scene_id in missing]
            request = shard_commit(lease, records, worker=leases.worker_id, sent=sent)
            answer = leases.commit(request, stop=keeper.drained)
            missing = answer.missing
            if answer.ok or not missing:
                return


if __name__ == "__main__":
    main(*sys.argv[1:])
