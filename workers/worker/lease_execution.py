"""Lease execution: one attempt to plan a log or mine a shard, to publish and to commit."""

import time
from contextlib import closing
from dataclasses import dataclass

import structlog
import zenoh

from schemas.work import (
    CommitRequest,
    ManifestEntry,
    MineLease,
    MiningStats,
    PlanLease,
    RescoredShard,
)
from workers.contradiction.origin import Origin
from workers.ingest.footer import TruncatedPart
from workers.ingest.plan import plan_recording
from workers.memory import peak_memory_bytes
from workers.mine import MiningReport, mine_records
from workers.rescore import rescore_scene
from workers.stage_timing import StageClock
from workers.worker.lease import LeaseKeeper, LeaseLostError, Leases
from workers.worker.logging import log_mined, log_planned, log_truncated, log_unread_labels
from workers.worker.metrics import WorkerMetrics
from workers.worker.store_health import put_artifact, reading_artifacts
from workers.worker.worker_context import WorkerContext

log = structlog.get_logger(__name__)

Lease = PlanLease | MineLease


@dataclass(frozen=True, slots=True)
class LeaseExecution:
    """Services that every attempt of one worker needs.

    Attributes:
        publisher: Publisher of the records.
        leases: Requests to the service.
        metrics: Counters of the worker.
    """

    publisher: zenoh.ext.AdvancedPublisher
    leases: Leases
    metrics: WorkerMetrics

    def plan(self, lease: PlanLease, context: WorkerContext, keeper: LeaseKeeper) -> None:
        """Plan a recording.

        Raises:
            StillGrowingError: If it is incomplete, and was listed only a moment ago; or if it waits
                for its predictions.
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
            context.bucket,
            lease.recording,
            context.settings,
            settled=lease.settled,
            waits=lease.waits,
            on_truncated=truncated.append,
            on_unread_labels=unread_labels.append,
        )
        self.metrics.planned(plan, truncated_parts=len(truncated))
        log_truncated(truncated)
        log_unread_labels(unread_labels)
        self._commit(self._request(lease, plan=plan), {}, keeper)
        seconds = time.monotonic() - began_s
        self.metrics.plan_committed(seconds)
        self.metrics.plan_ended("refused" if plan.refused else "committed")
        log_planned(plan, seconds=seconds)

    def mine(self, lease: MineLease, context: WorkerContext, keeper: LeaseKeeper) -> None:
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
        report = MiningReport()
        records: dict[str, bytes] = {}
        manifest: list[ManifestEntry] = []
        mining = mine_records(
            context.bucket,
            lease.recording,
            lease.shard,
            settings=context.settings,
            parts=context.parts,
            pipeline_version=context.version,
            report=report,
            check=keeper.check,
        )
        try:
            with closing(mining):
                for mined in mining:
                    with report.clock.stage("publishing"):
                        put_artifact(context.artifacts, mined.overlay_key, mined.overlay)
                        self.publisher.put(mined.record)
                    self.metrics.scene_mined(mined.score)
                    scene_id = mined.score.scene_id
                    records[scene_id] = mined.record
                    manifest.append(ManifestEntry(scene_id=scene_id, sha256=mined.sha256))
        finally:
            self._count(report)
        request = self._request(
            lease,
            manifest=tuple(manifest),
            damage=tuple(report.damage),
            stats=report.stats(),
        )
        with report.clock.stage("committing"):
            self._commit(request, records, keeper)
        seconds = time.monotonic() - began_s
        self.metrics.shard_committed(report.clock.seconds, seconds=seconds)
        self.metrics.shard_ended("committed")
        log_mined(report, seconds=seconds)

    def rescore(
        self,
        lease: MineLease,
        before: RescoredShard,
        context: WorkerContext,
        keeper: LeaseKeeper,
    ) -> None:
        """Score the scenes of a shard again, from the overlays of an earlier version.

        Raises:
            NotRescoredError: If an overlay is gone, or has no inputs of the score.
            StoreTroubleError: If the artifacts cannot be read or written.
            LeaseLostError: If the lease belongs to another worker.
            StoppedError: If the worker was stopped, and scoring did not end in time.
        """
        began_s = time.monotonic()
        clock = StageClock()
        records: dict[str, bytes] = {}
        manifest: list[ManifestEntry] = []
        for entry in before.scenes:
            keeper.check()
            with clock.stage("rescoring"), reading_artifacts(context.artifacts):
                again = rescore_scene(
                    *(context.artifacts, Origin.of(lease.shard), entry),
                    before=before.pipeline_version,
                    pipeline_version=context.version,
                    before_log_id=before.log_id,
                )
            with clock.stage("publishing"):
                put_artifact(context.artifacts, again.overlay_key, again.overlay)
                self.publisher.put(again.record)
            self.metrics.scene_mined(again.score)
            records[again.score.scene_id] = again.record
            manifest.append(ManifestEntry(scene_id=again.score.scene_id, sha256=again.sha256))
        stage_s = {name: round(s, 3) for name, s in sorted(clock.seconds.items())}
        stats = MiningStats(stage_s=stage_s, peak_memory_bytes=peak_memory_bytes())
        request = self._request(lease, manifest=tuple(manifest), stats=stats)
        with clock.stage("committing"):
            self._commit(request, records, keeper)
        seconds = time.monotonic() - began_s
        self.metrics.shard_committed(clock.seconds, seconds=seconds)
        self.metrics.shard_ended("rescored")
        log.debug("shard scored again", scenes=len(manifest), seconds=round(seconds, 2))

    def _count(self, report: MiningReport) -> None:
        self.metrics.mined(
            report.stats(),
            scenes=report.scenes,
            damage=report.damage,
            odometry_frames=report.odometry,
            blind_frames=report.blindness,
            motion_points=report.labels,
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
            log.debug("sending missing records again", scenes=len(answer.missing))
            again = tuple(records[scene_id].decode() for scene_id in answer.missing)
            request = request.model_copy(update={"records": again})

    def _request(self, lease: Lease, **result: object) -> CommitRequest:
        return CommitRequest.model_validate(
            {"worker_id": self.leases.worker_id, "lease_id": lease.lease_id, **result}
        )
