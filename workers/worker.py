"""The worker's loop: claim, read, mine, publish, commit; killed at any point, nothing is lost.

A worker keeps no state. Records go out on the bus as they are mined, overlays to the artifacts, and
then a commit names them all; the service answers it once everything is on disk. What was done
without that answer will be done again, byte for byte the same.
"""

import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Final

import structlog
import zenoh

from schemas import keys
from schemas.bus import client_session, recoverable_publisher
from schemas.errors import (
    BucketUnreachableError,
    CounterpointError,
    ObjectChangedError,
    PermanentError,
)
from schemas.retry import StoppedError, backoff_s, pause
from schemas.work import (
    CommitRequest,
    FailRequest,
    ManifestEntry,
    MineLease,
    NothingToDo,
    PlanLease,
)
from workers.equipment import Equipment, equip
from workers.ingest.plan import plan_recording
from workers.lease import LeaseKeeper, LeaseLostError, Leases
from workers.mine import Account, mine_records

log = structlog.get_logger(__name__)

DRAIN_S: Final = 20.0
"""A worker told to stop finishes its shard if that takes no longer; systems kill after 30 s."""

FAIL_PATIENCE_S: Final = 20.0
LAST_PATIENCE_S: Final = 3.0
"""How long to try to say that a lease failed, and how long when told to stop; after that it
expires, which says the same."""


@dataclass(frozen=True, slots=True)
class WorkerConfig:
    """What a worker must know before it can ask the service for the rest.

    Attributes:
        worker_id: Unique; the ids of one pool share a prefix.
        connect: Endpoints of routers.
        root: First part of every key.
        drain_s: How long a lease may still be worked on after being told to stop, seconds.
    """

    worker_id: str
    connect: tuple[str, ...]
    root: str = keys.DEFAULT_ROOT
    drain_s: float = DRAIN_S


def run_worker(
    config: WorkerConfig, *, stop: Event, on_lease: Callable[[bool], None] = lambda _: None
) -> None:
    """Work until told to stop.

    Args:
        config: Whom to ask.
        stop: When to end; a lease that is soon done is still finished.
        on_lease: Told true when work on a lease begins and false when it ends.

    Raises:
        TransientError: If bucket or artifacts cannot be opened now.
        PermanentError: If what the service asks for cannot be done here at all.
    """
    _one_thread_only()
    with client_session(config.connect, stop=stop) as session:
        alive = keys.live(root=config.root, role="worker", ident=config.worker_id)
        with session.liveliness().declare_token(alive):
            Worker(session, config, stop=stop, on_lease=on_lease).run()


class Worker:
    """One worker on one session."""

    def __init__(
        self,
        session: zenoh.Session,
        config: WorkerConfig,
        *,
        stop: Event,
        on_lease: Callable[[bool], None],
    ) -> None:
        self._session, self._config, self._stop, self._on_lease = session, config, stop, on_lease
        self._leases = Leases(session, root=config.root, worker_id=config.worker_id)
        self._equipped: Equipment | None = None

    def run(self) -> None:
        """Claim and work until told to stop."""
        try:
            while not self._stop.is_set():
                equipment = self._equipment()
                grant = self._leases.claim(equipment.version, stop=self._stop).grant
                if isinstance(grant, NothingToDo):
                    self._stop.wait(grant.retry_after_s)
                    continue
                self._on_lease(True)
                reachable = self._work(grant, equipment)
                self._on_lease(False)
                if not reachable:
                    self._wait_for_stores(grant, equipment)
        except StoppedError:
            pass
        log.info("worker stops", worker_id=self._config.worker_id)

    def _equipment(self) -> Equipment:
        """Ask every time: a service that was restarted may want something else now."""
        settings = self._leases.hello(stop=self._stop)
        if self._equipped is None or self._equipped.settings != settings:
            self._equipped = equip(settings)
            log.info(
                "worker ready",
                worker_id=self._config.worker_id,
                pipeline_version=self._equipped.version,
            )
        return self._equipped

    def _work(self, lease: PlanLease | MineLease, equipment: Equipment) -> bool:
        """Do what a lease asks for, or say why not; only a bug escapes, after it was said too.

        Returns:
            False when a store did not answer: then the next lease would fail the same way.
        """
        with (
            structlog.contextvars.bound_contextvars(**_ids(lease)),
            LeaseKeeper(
                self._leases, lease, stop=self._stop, drain_s=self._config.drain_s
            ) as keeper,
        ):
            try:
                if isinstance(lease, PlanLease):
                    self._plan(lease, equipment, keeper)
                else:
                    self._mine(lease, equipment, keeper)
            except LeaseLostError as error:
                log.warning("lease abandoned", problem=str(error))
            except CounterpointError as error:
                self._fail(lease, error)
                return not isinstance(error, BucketUnreachableError)
            except Exception as error:
                self._fail(lease, error)
                raise
        return True

    def _wait_for_stores(self, lease: PlanLease | MineLease, equipment: Equipment) -> None:
        """Claim nothing while bucket or artifacts are away: an outage must not park every shard."""
        for wait_s in backoff_s(first_s=1.0, most_s=30.0):
            pause(self._stop, wait_s)
            try:
                for store in (equipment.bucket, equipment.artifacts):
                    store.head(lease.recording.parts[0].key)
            except BucketUnreachableError as error:
                log.info("store still unreachable", problem=str(error))
            else:
                return

    def _plan(self, lease: PlanLease, equipment: Equipment, keeper: LeaseKeeper) -> None:
        plan = plan_recording(equipment.bucket, lease.recording, equipment.settings)
        self._commit(self._request(lease, plan=plan), {}, keeper)
        if plan.refused:
            log.warning("log refused", problem=plan.refused)
        else:
            log.info("log planned", shards=len(plan.shards), damage=len(plan.damage))

    def _mine(self, lease: MineLease, equipment: Equipment, keeper: LeaseKeeper) -> None:
        account = Account()
        records: dict[str, bytes] = {}
        manifest: list[ManifestEntry] = []
        key = keys.score(
            root=self._config.root, log_id=lease.recording.log_id, shard=lease.shard.name
        )
        with recoverable_publisher(self._session, key) as publisher:
            for mined in mine_records(
                equipment.bucket,
                lease.recording,
                lease.shard,
                settings=equipment.settings,
                parts=equipment.parts,
                pipeline_version=equipment.version,
                account=account,
                check=keeper.check,
            ):
                with account.clock.stage("publishing"):
                    equipment.artifacts.put(mined.overlay_key, mined.overlay)
                    publisher.put(mined.record)
                records[mined.score.scene_id] = mined.record
                manifest.append(ManifestEntry(scene_id=mined.score.scene_id, sha256=mined.sha256))
            request = self._request(
                lease,
                manifest=tuple(manifest),
                damage=tuple(account.damage),
                stats=account.stats(),
            )
            self._commit(request, records, keeper)
        log.info("shard mined", scenes=len(manifest), frames=account.frames)

    def _commit(
        self, request: CommitRequest, records: dict[str, bytes], keeper: LeaseKeeper
    ) -> None:
        """Repeat the commit, with what is missing, until the service has everything on disk."""
        while True:
            answer = self._leases.commit(request, stop=keeper.drained)
            if answer.ok:
                return
            if not answer.missing:
                raise LeaseLostError(f"commit refused: {answer.problem}")
            log.debug("sending again", scenes=len(answer.missing))
            again = tuple(records[scene_id].decode() for scene_id in answer.missing)
            request = request.model_copy(update={"records": again})

    def _request(self, lease: PlanLease | MineLease, **result: object) -> CommitRequest:
        return CommitRequest.model_validate(
            {"worker_id": self._config.worker_id, "lease_id": lease.lease_id, **result}
        )

    def _fail(self, lease: PlanLease | MineLease, error: Exception) -> None:
        on_purpose = isinstance(error, CounterpointError)
        if isinstance(error, StoppedError):
            log.info("lease given back", reason=str(error))
        else:
            log.warning("lease failed", problem=str(error) if on_purpose else _summary(error))
        self._leases.fail(
            FailRequest(
                worker_id=self._config.worker_id,
                lease_id=lease.lease_id,
                error=str(error) if on_purpose else _summary(error),
                permanent=isinstance(error, PermanentError),
                replaced=isinstance(error, ObjectChangedError),
                given_back=isinstance(error, StoppedError),
            ),
            patience_s=LAST_PATIENCE_S if self._stop.is_set() else FAIL_PATIENCE_S,
        )


def _ids(lease: PlanLease | MineLease) -> dict[str, str]:
    ids = {"log_id": lease.recording.log_id, "lease_id": lease.lease_id}
    return ids | {"shard": lease.shard.name} if isinstance(lease, MineLease) else ids


def _summary(error: Exception) -> str:
    """Say what and where in one line: a ledger is no place for a whole traceback."""
    frames: Sequence[traceback.FrameSummary] = traceback.extract_tb(error.__traceback__)
    where = "; ".join(f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in frames[-3:])
    return f"{type(error).__name__}: {error} ({where})"


def _one_thread_only() -> None:
    """More cores are more workers, and results must not hang on how many there are."""
    import torch

    torch.set_num_threads(1)
