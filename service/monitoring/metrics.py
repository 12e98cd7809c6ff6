"""Counters of the service, with labels and alert hints; `gauges` has the other metrics.

Everything is counted once, after the transaction that made it true. A commit that is repeated or
refused counts no frame, scene or point, however often a worker tries.
"""

from collections import Counter as Counts
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from itertools import product
from typing import Final, Literal, TypeVar, get_args

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, disable_created_metrics

from schemas.contradiction import ContradictionKind, SceneState
from schemas.labels import Agreement
from schemas.score import SceneScore
from schemas.verdict import Verdict
from service.api.request_queue import Outcome
from service.api.verbs import ASKED
from service.background.webhooks import Outcome as WebhookOutcome
from service.monitoring.gauges import NAMESPACE, ServiceGauges, Sources
from service.store.events import point_counts
from service.store.transaction_effects import CommitOutcome, Effects, WorkKind

LeaseEnd = Literal[
    "committed",
    "failed",
    "expired",
    "worker_died",
    "given_back",
    "growing",
    "replaced",
    "freed",
    "not_rescored",
]
"""Cause of the end of a lease.

`committed`: finished. `failed`: the worker reported an error. `expired`: not renewed.
`worker_died`: its process died. `given_back`: returned at a stop. `growing`: the log grows, or
awaits its predictions. `replaced`: the recording was replaced or deleted. `freed`: its pool was
ended. `not_rescored`: an overlay is gone, so that the shard is mined.
"""

FaultyPart = Literal["request", "tick", "event"]
"""Part of the service in which an unexpected error occurred."""

OTHER_VEHICLES: Final = "other"
MOST_VEHICLES: Final = 50
"""Vehicles with series of their own, six each; `counterpoint rates` serves larger fleets."""

AGREEMENTS: Final = tuple(agreement.name.lower() for agreement in Agreement)

SCORE_BUCKETS: Final = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
COMPARED: Final = ("passed", "regressed")
COMMIT_BUCKETS_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0)
"""Bucket bounds around the few milliseconds of a durable commit on a dedicated disk, seconds."""

Metric = TypeVar("Metric", Counter, Gauge, Histogram)


class ServiceMetrics:
    """Counters of the service; a `StoreObserver` that the ledger calls after every transaction."""

    def __init__(
        self, registry: CollectorRegistry | None = None, *, vehicles: Sequence[str] = ()
    ) -> None:
        """Make every series at once, so that each exists from the first scrape on.

        Args:
            registry: Registry of the metrics; by default one of its own.
            vehicles: Vehicles with series of their own, at most `MOST_VEHICLES`; all others count
                as `other`.
        """
        # A second series for each counter is not needed.
        disable_created_metrics()  # type: ignore[no-untyped-call]
        self.registry = registry or CollectorRegistry()
        self._vehicles = frozenset(vehicles[:MOST_VEHICLES])
        by_vehicle = (*sorted(self._vehicles), OTHER_VEHICLES)
        self._frames = self._counter(
            "frames",
            "Lidar frames of stored scenes, each once. Worry when its rate is 0 while work waits.",
        )
        self._scenes = self._counter(
            "scenes",
            "Scenes stored, each once, by usability of their score. Worry when the share of "
            "`odometry_lost` grows: poses fail, and those scenes rank last unseen.",
            state=tuple(SceneState),
        )
        self._points = self._counter(
            "points",
            "Points of stored scenes by agreement of the two streams, each once. The "
            "disagreement rate is the rate of the two `only_` agreements over that of all but "
            "`not_compared`. Worry when it leaves its usual band: a model, a sensor or a "
            "calibration has changed.",
            agreement=AGREEMENTS,
        )
        self._tracks = self._counter(
            "contradicting_tracks",
            "Contradicting objects tracked over a scene, by the stream that alone labels them "
            "dynamic. Worry when one kind grows against the other: that stream has changed.",
            kind=tuple(ContradictionKind),
        )
        self._instances = self._counter(
            "contradicting_instances",
            "Contradicting clusters over all frames, by the stream that alone labels them "
            "dynamic. Worry when it grows and the tracks do not: labels flicker.",
            kind=tuple(ContradictionKind),
        )
        self._score = self._histogram(
            "scene_score",
            "Scores of stored scenes, 0 to 1. Worry when the upper buckets fill at once: a fault "
            "of a stream floods the ranking.",
            SCORE_BUCKETS,
        )
        self._vehicle_scenes = self._counter(
            "vehicle_scenes",
            "Scenes stored by vehicle; those not in the setting `vehicles` are `other`. Worry "
            "when the rate of one falls to 0.",
            vehicle=by_vehicle,
        )
        self._vehicle_points = self._counter(
            "vehicle_points",
            "Points by vehicle and agreement, as in counterpoint_points_total. Worry when one "
            "vehicle's disagreement departs from that of the others: its sensor or calibration.",
            vehicle=by_vehicle,
            agreement=AGREEMENTS,
        )
        self._commits = self._counter(
            "commits",
            "Commits of plans and shards by outcome. Worry when `refused` grows (the log has the "
            "cause), or `missing` exceeds a few percent: records are lost on the bus.",
            work=get_args(WorkKind),
            outcome=get_args(CommitOutcome),
        )
        self._commit_seconds = self._histogram(
            "commit_seconds",
            "Time to make one commit durable. Worry above 0.5 s: the disk of the state is slow or "
            "shared.",
            COMMIT_BUCKETS_S,
        )
        self._leases_ended = self._counter(
            "leases_ended",
            "Leases that ended, by cause. Worry when `expired`, `failed` or `worker_died` grow: "
            "each is a lost attempt, and the last one parks the work.",
            reason=get_args(LeaseEnd),
        )
        self._parked = self._counter(
            "work_parked",
            "Plans and shards parked, which are not retried until `counterpoint retry`. Worry at "
            "any growth; `counterpoint status` names each with its error.",
            work=get_args(WorkKind),
        )
        self._retried = self._counter(
            "work_retried",
            "Parked plans and shards retried by `counterpoint retry`. Worry when the parked ones "
            "grow again afterwards: the cause of their failure remains.",
            work=get_args(WorkKind),
        )
        self._verdicts = self._counter(
            "verdicts",
            "Verdicts of reviewers by value, undos (`withdrawn`) included. Worry when `unsure` or "
            "`duplicate` takes over: the pictures or the choice of scenes do not help.",
            verdict=tuple(Verdict),
        )
        self._comparisons = self._counter(
            "comparisons",
            "Comparisons of two versions by result; `regressed`: a kind, class or mode of tracks "
            "occurs significantly more often in version B, or B answers less. Worry at any "
            "`regressed`: `counterpoint compare` names the groups, and the scenes that show it.",
            result=COMPARED,
        )
        self._questions = self._counter(
            "questions",
            "Questions from the bus by verb and outcome. Worry when `try_again` grows: the service "
            "is too busy, or its database does not answer.",
            verb=ASKED,
            outcome=get_args(Outcome),
        )
        self._database_errors = self._counter(
            "database_errors",
            "Transactions that the database could not finish. Worry at any growth: the disk is "
            "full, the database locked, or its server does not answer; nothing acknowledged is "
            "lost.",
        )
        self._damaged_records = self._counter(
            "damaged_records",
            "Stored records that do not match their digest, each once. Worry at any: the disk of "
            "the database damages data; the log names the records, and none is shown.",
        )
        self._faults = self._counter(
            "faults",
            "Unexpected errors by part: `question` the answer of a request, `tick` periodic "
            "work, `event` a scene that the bus cannot carry and that is skipped. The service "
            "goes on. Worry at any growth: the log has the trace.",
            part=get_args(FaultyPart),
        )
        self._webhooks = self._counter(
            "webhook_attempts",
            "Attempts to deliver an event to a receiver of `webhooks`, by outcome. Worry when "
            "`failed` grows: the log has the host and the cause.",
            outcome=get_args(WebhookOutcome),
        )
        self._new_modes = self._counter(
            "new_modes",
            "Failure modes that were not there before, while webhooks for `mode.new` are on. Worry "
            "at any: `counterpoint modes` lists them.",
        )
        self._gauges: ServiceGauges | None = None
        build = Gauge(
            "build_info",
            "Always 1; its label is the running version.",
            ("version",),
            NAMESPACE,
            registry=self.registry,
        )
        build.labels(version("counterpoint")).set(1)

    def on_effects(self, effects: Effects) -> None:
        """Count the effects of a transaction that is on disk."""
        if effects.scenes:
            self._count_scenes(effects.scenes)
        for (work, outcome), count in effects.commits.items():
            self._commits.labels(work, outcome).inc(count)
        for reason, count in effects.leases_ended.items():
            self._leases_ended.labels(reason.replace(" ", "_")).inc(count)
        for work, count in effects.parked.items():
            self._parked.labels(work).inc(count)
        for work, count in effects.retried.items():
            self._retried.labels(work).inc(count)
        for verdict, count in effects.verdicts.items():
            self._verdicts.labels(verdict.value).inc(count)

    def on_database_error(self) -> None:
        """Count a failed transaction."""
        self._database_errors.inc()

    def on_damaged_record(self) -> None:
        """Count a stored record that is damaged."""
        self._damaged_records.inc()

    def committed(self, seconds: float) -> None:
        """Record the time of one durable commit."""
        self._commit_seconds.observe(seconds)

    def compared(self, regressed: bool) -> None:
        """Count a comparison of two versions."""
        self._comparisons.labels("regressed" if regressed else "passed").inc()

    def asked(self, verb: str, outcome: Outcome) -> None:
        """Count a question."""
        self._questions.labels(verb, outcome).inc()

    def webhook(self, outcome: WebhookOutcome) -> None:
        """Count an attempt to deliver a webhook."""
        self._webhooks.labels(outcome).inc()

    def new_modes(self, count: int) -> None:
        """Count failure modes that were not there before."""
        self._new_modes.inc(count)

    def faulted(self, part: FaultyPart) -> None:
        """Count an unexpected error."""
        self._faults.labels(part).inc()

    def read_from(self, sources: Sources) -> None:
        """Also serve gauges from these sources; a further call replaces them."""
        if self._gauges is None:
            self._gauges = ServiceGauges(sources)
            self.registry.register(self._gauges)
        else:
            self._gauges.read_from(sources)

    def _count_scenes(self, scores: Sequence[SceneScore]) -> None:
        # Summed up first: a counter takes longer to find and raise than all else here.
        scenes: Counts[tuple[str, str]] = Counts()
        points: Counts[tuple[str, str]] = Counts()
        tracks: Counts[str] = Counts()
        instances: Counts[str] = Counts()
        for score in scores:
            vehicle = score.vehicle if score.vehicle in self._vehicles else OTHER_VEHICLES
            scenes[vehicle, score.state.value] += 1
            for agreement, count in point_counts(score).items():
                points[vehicle, agreement] += count
            for total in score.totals:
                tracks[total.kind] += total.tracks
                instances[total.kind] += total.instances
            self._score.observe(score.score)
        self._frames.inc(sum(score.frames for score in scores))
        for (vehicle, state), count in scenes.items():
            self._scenes.labels(state).inc(count)
            self._vehicle_scenes.labels(vehicle).inc(count)
        for (vehicle, agreement), count in points.items():
            self._points.labels(agreement).inc(count)
            self._vehicle_points.labels(vehicle, agreement).inc(count)
        for kind in tracks:
            self._tracks.labels(kind).inc(tracks[kind])
            self._instances.labels(kind).inc(instances[kind])

    def _counter(self, name: str, help_: str, **labels: tuple[str, ...]) -> Counter:
        made = Counter(name, help_, list(labels), NAMESPACE, registry=self.registry)
        return with_series(made, labels)

    def _histogram(self, name: str, help_: str, buckets: Sequence[float]) -> Histogram:
        return Histogram(name, help_, (), NAMESPACE, registry=self.registry, buckets=buckets)


def with_series(metric: Metric, labels: Mapping[str, tuple[str, ...]]) -> Metric:
    """Make the series of every combination of labels, since a rate must start from zero."""
    if labels:
        for combination in product(*labels.values()):
            metric.labels(*combination)
    return metric
