"""Lease execution: one attempt to plan a log or mine a shard, to publish and to commit."""

import time
from contextlib import closing
from dataclasses import dataclass

import structlog
import zenoh

from schemas.work import CommitRequest, ManifestEntry, MineLease, PlanLease
from workers.ingest.footer import TruncatedPart
from workers.ingest.plan import plan_recording
from workers.mine import Account, mine_records
from workers.worker.lease import LeaseKeeper, LeaseLostError, Leases
from workers.worker.logging import tell_mined, tell_planned, tell_truncated, tell_unread_labels
from workers.worker.metrics import WorkerMetrics
from workers.worker.store_health import put_artifact
from workers.worker.worker_context import Equipment

log = structlog.get_logger(__name__)

Lease = PlanLease | MineLease


@dataclass(frozen=True, slots=True)
class Attempts:
    """Services that every attempt of one worker needs.

    Attributes:
        publisher: Publisher of the records.
        leases: Requests to the service.
        metrics: Counters of the worker.
    """

    publisher: zenoh.ext.AdvancedPublisher
    leases: Leases
    metrics: WorkerMetrics

    def plan(self, lease: PlanLease, equipment: Equipment, keeper: LeaseKeeper) -> None:
        """Plan a recording.

        Raises:
            StillGrowingError: If it is incomplete, and was listed only a moment ago.
            BucketUnreachableError: If the bucket does not answer.
            BucketRefusedError: If the bucket refuses.
            ObjectChangedError: If a part is no longer the listed one.
            LeaseLostError: If another worker was faster.
            StoppedError: If the worker was stopped, and the commit was not accepted in time.
        """
        began_s = time.monotonic()
        truncated: list[TruncatedPart] = []
        unread_labels: list[str] = []
        plan = plan_recording(
            equipment.bucket,
            lease.recording,
            equipment.settings,
            settled=lease.settled,
            on_truncated=truncated.append,
            on_unread_labels=unread_labels.append,
        )
        self.metrics.planned(plan, truncated_parts=len(truncated))
        tell_truncated(truncated)
        tell_unread_labels(unread_labels)
        self._commit(self._request(lease, plan=plan), {}, keeper)
        seconds = time.monotonic() - began_s
        self.metrics.plan_committed(seconds)
        self.metrics.plan_ended("refused" if plan.refused else "committed")
        tell_planned(plan, seconds=seconds)

    def mine(self, lease: MineLease, equipment: Equipment, keeper: LeaseKeeper) -> None:
        """Mine a shard.

        Raises:
            BucketUnreachableError: If the bucket does not answer.
            BucketRefusedError: If the bucket refuses.
            StoreTroubleError: If overlays cannot be written.
            ObjectChangedError: If an object is no longer the planned one.
            LeaseLostError: If the lease belongs to another worker.
            StoppedError: If the worker was stopped, and mining did not end in time.
            PermanentError: If the shard can never be mined.
        """
        began_s = time.monotonic()
        account = Account()
        records: dict[str, bytes] = {}
        manifest: list[ManifestEntry] = []
        mining = mine_records(
            equipment.bucket,
            lease.recording,
            lease.shard,
            settings=equipment.settings,
            parts=equipment.parts,
            pipeline_version=equipment.version,
            account=account,
            check=keeper.check,
        )
        try:
            with closing(mining):
                for mined in mining:
                    with account.clock.stage("publishing"):
                        put_artifact(equipment.artifacts, mined.overlay_key, mined.overlay)
                        self.publisher.put(mined.record)
                    self.metrics.scene_mined(mined.score)
                    scene_id = mined.score.scene_id
                    records[scene_id] = mined.record
                    manifest.append(ManifestEntry(scene_id=scene_id, sha256=mined.sha256))
        finally:
            self._count(account)
        request = self._request(
            lease,
            manifest=tuple(manifest),
            damage=tuple(account.damage),
            stats=account.stats(),
        )
        with account.clock.stage("committing"):
            self._commit(request, records, keeper)
        seconds = time.monotonic() - began_s
        self.metrics.shard_committed(account.clock.seconds, seconds=seconds)
        self.metrics.shard_ended("committed")
        tell_mined(account, seconds=seconds)

    def _count(self, account: Account) -> None:
        self.metrics.mined(
            account.stats(),
            scenes=account.scenes,
            damaged=len(account.damage),
            odometry_frames=account.odometry,
            blind_frames=account.blindness,
            motion_points=account.labels,
        )

    def _commit(
        self, request: CommitRequest, records: dict[str, bytes], keeper: LeaseKeeper
    ) -> None:
        """Repeat the commit, with the missing records, until the service has everything on disk."""
        while True:
            answer = self.leases.commit(request, stop=keeper.drained)
            if answer.ok:
                return
            if not answer.missing:
                raise LeaseLostError(f"commit refused: {answer.problem}")
            log.debug("sending again", scenes=len(answer.missing))
            again = tuple(records[scene_id].decode() for scene_id in answer.missing)
            request = request.model_copy(update={"records": again})

    def _request(self, lease: Lease, **result: object) -> CommitRequest:
        return CommitRequest.model_validate(
            {"worker_id": self.leases.worker_id, "lease_id": lease.lease_id, **result}
        )
