"""Every metric of the workers and of their pool, with its labels and alarm conditions."""

from collections.abc import Iterable, Mapping
from itertools import product
from typing import Final, Literal, TypeVar, get_args

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    disable_created_metrics,
)

from schemas.frame import OdometryState
from schemas.labels import Blindness
from schemas.score import SceneScore
from schemas.task import MOTION
from schemas.work import Damage, LogPlan, MiningStats
from workers.stage_timing import Stage

NAMESPACE: Final = "counterpoint"
SUBSYSTEM: Final = "worker"

CommonOutcome = Literal["committed", "failed", "lost", "given_back", "replaced", "store_away"]
ShardOutcome = Literal[CommonOutcome, "rescored", "not_rescored"]
"""Ends of a shard's lease: committed; failed attempt; lease lost to another worker; given back at a
stop; object replaced; store unreachable, or refusing everything; committed with scores computed
again; an overlay is gone, so that the shard is mined."""

PlanOutcome = Literal[CommonOutcome, "refused", "growing"]
"""Ends of a plan's lease, as those of shards; refused: committed as a log that cannot be mined;
growing: not yet complete."""

Work = Literal["plan", "mine"]
Store = Literal["bucket", "artifacts", "predictions"]
StoreError = Literal["unreachable", "refused"]
Death = Literal["crashed", "stuck", "unready", "gave_up", "stopped"]
"""Causes of a worker process's end without its pool's request.

They are: a crash or kill; too long on one lease; a requirement missing at its start; settings of
the service that it cannot use; a stop by another process."""

SHARD_BUCKETS_S: Final = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 20.0, 40.0, 80.0, 160.0)
"""Buckets around the 20 s of lidar in a default shard, seconds."""

RESIDUAL_BUCKETS_M: Final = (0.02, 0.04, 0.06, 0.08, 0.1, 0.15, 0.2, 0.3, 0.5)
"""Buckets around 0.1 m, the residual from the spacing of 64 beams alone, metres."""

SHARE_BUCKETS: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)

Metric = TypeVar("Metric", Counter, Gauge, Histogram)


class WorkerMetrics:
    """Metrics of one worker; a pool serves the sum over its workers.

    All of them count attempts: a shard that is mined twice counts twice. The service's metrics
    count each scene once.
    """

    def __init__(self, registry: CollectorRegistry | None = None) -> None:
        """Create every series at once, so that each is there from the first scrape on.

        Args:
            registry: Registry of the metrics; by default one of its own.
        """
        self.registry = registry or CollectorRegistry()
        self._shards = self._counter(
            "shards",
            "Shards whose lease ended here, by outcome. Worry when `failed` grows: the ledger "
            "names log and error. `store_away` costs no attempt. `rescored`: scores computed again "
            "without the log. Worry when `not_rescored` grows: overlays are gone, or cannot be "
            "read, and their shards are mined.",
            outcome=get_args(ShardOutcome),
        )
        self._plans = self._counter(
            "plans",
            "Logs whose planning lease ended here, by outcome. `growing` is an upload in progress; "
            "worry when one log stays so for longer than an upload takes.",
            outcome=get_args(PlanOutcome),
        )
        self._frames = self._counter(
            "frames",
            "Lidar frames mined, warm-up excluded, attempts included. Worry when its rate is 0 "
            "while work is queued.",
        )
        self._scenes = self._counter(
            "scenes", "Scenes mined and published, attempts included: retries count again."
        )
        self._odometry_frames = self._counter(
            "odometry_frames",
            "Mined frames by the health of their pose. Worry when more than a tenth are "
            "not healthy: degraded poses lower a scene's score, lost ones void it.",
            state=tuple(OdometryState),
        )
        self._pose_jumps = self._counter(
            "pose_jumps",
            "Mined frames whose pose moved as no car can from one frame to the next. Worry when "
            "it grows steadily: frames are dropped, or time stamps are wrong.",
        )
        self._blind_frames = self._counter(
            "blind_frames",
            "Mined frames in which the self-supervised stream labelled nothing off the ground, "
            "by cause. `no_past` is the start of a log or a gap. Worry when the others exceed a "
            "tenth.",
            cause=tuple(Blindness),
        )
        self._motion_points = self._counter(
            "motion_points",
            "Returns of the mined frames by their label of the self-supervised stream. Worry when "
            "the share of `unknown` rises: the stream has lost its evidence, and finds no motion.",
            label=MOTION.labels,
        )
        self._static_residual = self._histogram(
            "static_residual_m",
            "Median distance of static structure to the frame before, metres, by scene. Worry when "
            "it rises: poses, calibration or time stamps got worse.",
            buckets=RESIDUAL_BUCKETS_M,
        )
        self._seen_share = self._histogram(
            "seen_share",
            "Share of the voxels off the ground that another frame saw or saw through, by scene, "
            "for the self-supervised stream. Worry below a half: beams or origin of the sensor "
            "are wrong.",
            buckets=SHARE_BUCKETS,
        )
        self._damaged_chunks = self._counter(
            "damaged_chunks",
            "Stretches of logs, mostly one chunk each, that could not be read. Worry when it grows "
            "steadily: a recorder or an upload loses data.",
        )
        self._truncated_parts = self._counter(
            "truncated_parts",
            "Objects that end without a valid footer, planned as far as they go. Worry when it "
            "grows steadily: uploads break off, or recorders are cut off.",
        )
        self._bytes_read = self._counter(
            "bytes_read", "Bytes read from the log bucket, to plan or to mine.", work=get_args(Work)
        )
        self._bytes_needed = self._counter(
            "bytes_needed",
            "Stored bytes of the chunks that hold mined frames. Worry when bytes read to mine "
            "exceed twice this: shards are too short for these logs.",
        )
        self._pictures = self._counter(
            "pictures",
            "Camera pictures kept with mined scenes, attempts included; 0 where the setting "
            "`pictures` is none, and in logs without calibrated cameras.",
        )
        self._picture_bytes = self._counter(
            "picture_bytes",
            "Bytes of these pictures, in the artifacts. Worry when they grow faster than the "
            "artifacts may: `pictures = small` keeps at most eight a scene.",
        )
        self._range_reads = self._counter(
            "range_reads", "Requests to the log bucket, to plan or to mine.", work=get_args(Work)
        )
        self._store_errors = self._counter(
            "store_errors",
            "Leases given up because a store did not answer, or refused. Worry when it grows for "
            "minutes: unreachable is the network or the store, refused is credentials.",
            store=get_args(Store),
            kind=get_args(StoreError),
        )
        self._renewals_failed = self._counter(
            "lease_renewals_failed",
            "Renewals of leases that got no answer. Worry when it grows steadily: two in a row may "
            "cost the lease, and the shard is mined again.",
        )
        self._stage_seconds = self._histogram(
            "stage_seconds",
            "Time of one stage over one shard. Worry when the stages together exceed what a shard "
            "lasts: then one worker falls behind one car.",
            stage=get_args(Stage),
        )
        self._shard_seconds = self._histogram(
            "shard_seconds",
            "Time from lease to commit of one shard. Worry when it comes near shard_deadline_s.",
        )
        self._plan_seconds = self._histogram(
            "plan_seconds",
            "Time from lease to commit of one plan. Worry above 10 s: the log has no usable index, "
            "or the bucket is slow.",
        )
        self._connected = self._gauge(
            "connected",
            "Workers that have a router now. Worry when below the processes alive for a minute.",
            mode="livesum",
        )
        self._busy = self._gauge(
            "busy",
            "Workers at work on a lease now. Worry when it is 0 while work is queued.",
            mode="livesum",
        )
        self._waiting = self._gauge(
            "waiting_for_store",
            "Workers that claim nothing until this store works again. Worry when above 0 for "
            "minutes.",
            mode="livesum",
            store=get_args(Store),
        )
        self._peak_memory = self._gauge(
            "peak_memory_bytes",
            "Most memory that any worker process alive has held. Worry near the memory of the "
            "machine divided by its workers.",
            mode="livemax",
        )

    def lease_began(self) -> None:
        """Note the start of work on a lease."""
        self._busy.set(1)

    def lease_ended(self) -> None:
        """Note the end of work on a lease."""
        self._busy.set(0)

    def shard_ended(self, outcome: ShardOutcome) -> None:
        """Count a shard's lease that is over."""
        self._shards.labels(outcome).inc()

    def plan_ended(self, outcome: PlanOutcome) -> None:
        """Count a plan's lease that is over."""
        self._plans.labels(outcome).inc()

    def planned(self, plan: LogPlan, *, truncated_parts: int) -> None:
        """Count the reads and findings of planning."""
        self._bytes_read.labels("plan").inc(plan.bytes_read)
        self._range_reads.labels("plan").inc(plan.range_reads)
        self._damaged_chunks.inc(_unreadable(plan.damage))
        self._truncated_parts.inc(truncated_parts)

    def plan_committed(self, seconds: float) -> None:
        """Note the time of a plan, from lease to commit."""
        self._plan_seconds.observe(seconds)

    def mined(
        self,
        stats: MiningStats,
        *,
        scenes: int,
        damage: Iterable[Damage],
        odometry_frames: Mapping[OdometryState, int],
        blind_frames: Mapping[Blindness, int],
        motion_points: Mapping[str, int],
    ) -> None:
        """Count the reads and results of one attempt at a shard, committed or not.

        Args:
            stats: Sums over the attempt.
            scenes: Number of published scenes.
            damage: Stretches that could not be read, and notices.
            odometry_frames: Frames by the health of their pose.
            blind_frames: Frames without labels of the self-supervised stream, by cause.
            motion_points: Returns by that stream's label, by name.
        """
        self._frames.inc(stats.frames)
        self._scenes.inc(scenes)
        self._damaged_chunks.inc(_unreadable(damage))
        self._bytes_read.labels("mine").inc(stats.bytes_read)
        self._bytes_needed.inc(stats.bytes_needed)
        self._range_reads.labels("mine").inc(stats.range_reads)
        self._pictures.inc(stats.pictures)
        self._picture_bytes.inc(stats.picture_bytes)
        self._peak_memory.set(stats.peak_memory_bytes)
        for state, frames in odometry_frames.items():
            self._odometry_frames.labels(state.value).inc(frames)
        for cause, frames in blind_frames.items():
            self._blind_frames.labels(cause.value).inc(frames)
        for label, points in motion_points.items():
            self._motion_points.labels(label).inc(points)

    def scene_mined(self, score: SceneScore) -> None:
        """Note the odometry residual and the free-space coverage of one scene."""
        if score.odometry.static_residual_m > 0.0:  # 0 where nothing was measured
            self._static_residual.observe(score.odometry.static_residual_m)
        if score.health is not None:
            self._pose_jumps.inc(score.health.pose_jumps)
            if score.health.seen_share is not None:
                self._seen_share.observe(score.health.seen_share)

    def shard_committed(self, stage_s: Mapping[Stage, float], *, seconds: float) -> None:
        """Note the time of a shard, by stage and from lease to commit."""
        for stage, spent_s in stage_s.items():
            self._stage_seconds.labels(stage).observe(spent_s)
        self._shard_seconds.observe(seconds)

    def router_seen(self, connected: bool) -> None:
        """Note the presence of a router."""
        self._connected.set(connected)

    def store_failed(self, store: Store, kind: StoreError) -> None:
        """Count a lease given up because of a store."""
        self._store_errors.labels(store, kind).inc()

    def waiting_for(self, store: Store, waits: bool) -> None:
        """Note that a worker waits for a store, or no longer does."""
        self._waiting.labels(store).set(waits)

    def renewal_failed(self) -> None:
        """Count a renewal without an answer."""
        self._renewals_failed.inc()

    def _counter(self, name: str, help_: str, **labels: tuple[str, ...]) -> Counter:
        return _with_series(
            Counter(name, help_, list(labels), NAMESPACE, SUBSYSTEM, registry=self.registry), labels
        )

    def _histogram(
        self,
        name: str,
        help_: str,
        *,
        buckets: tuple[float, ...] = SHARD_BUCKETS_S,
        **labels: tuple[str, ...],
    ) -> Histogram:
        made = Histogram(
            name,
            help_,
            list(labels),
            NAMESPACE,
            SUBSYSTEM,
            registry=self.registry,
            buckets=buckets,
        )
        return _with_series(made, labels)

    def _gauge(
        self,
        name: str,
        help_: str,
        *,
        mode: Literal["livesum", "livemax"],
        **labels: tuple[str, ...],
    ) -> Gauge:
        made = Gauge(
            name,
            help_,
            list(labels),
            NAMESPACE,
            SUBSYSTEM,
            registry=self.registry,
            multiprocess_mode=mode,
        )
        return _with_series(made, labels)


class PoolMetrics:
    """Metrics of the processes that a pool keeps alive."""

    def __init__(self, registry: CollectorRegistry) -> None:
        """Create every series at once."""
        # one more series per counter, without a reader
        disable_created_metrics()  # type: ignore[no-untyped-call]  # upstream lacks the types
        self.wanted = Gauge(
            "processes_wanted",
            "Worker processes that this pool keeps alive.",
            (),
            NAMESPACE,
            SUBSYSTEM,
            registry=registry,
        )
        self.alive = Gauge(
            "processes_alive",
            "Worker processes that run now. Worry when below those wanted for a minute.",
            (),
            NAMESPACE,
            SUBSYSTEM,
            registry=registry,
        )
        self._deaths = _with_series(
            Counter(
                "restarts",
                "Worker processes that ended unasked, by cause; all but `gave_up` are replaced. "
                "Worry when it grows more than once an hour: `crashed` is often too little memory.",
                ("cause",),
                NAMESPACE,
                SUBSYSTEM,
                registry=registry,
            ),
            {"cause": get_args(Death)},
        )

    def died(self, cause: Death) -> None:
        """Count a process that ended unasked."""
        self._deaths.labels(cause).inc()


def _with_series(metric: Metric, labels: Mapping[str, tuple[str, ...]]) -> Metric:
    """Create the series of every combination of labels: a rate needs a zero to rise from."""
    if labels:
        for combination in product(*labels.values()):
            metric.labels(*combination)
    return metric


def _unreadable(damage: Iterable[Damage]) -> int:
    return sum(not each.is_notice for each in damage)
