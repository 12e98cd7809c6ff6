"""Every metric that the service counts, with its labels and when to worry; `gauges` has the rest.

All of it is counted once, after the transaction that made it true: a commit that is repeated or
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
from service.api.request_queue import Outcome
from service.api.verbs import ASKED
from service.monitoring.gauges import NAMESPACE, ServiceGauges, Sources
from service.store.events import point_counts
from service.store.transaction_effects import CommitOutcome, Effects, WorkKind

LeaseEnd = Literal[
    "committed", "failed", "expired", "worker_died", "given_back", "growing", "replaced", "freed"
]
"""Why a lease ended: finished; its worker said why not; nobody renewed it; its process died; handed
back at a stop; its log still grows; its recording was replaced or deleted; its pool was ended."""

FaultyPart = Literal["question", "tick", "event"]
"""What an error that nobody foresaw met."""

OTHER_VEHICLES: Final = "other"
MOST_VEHICLES: Final = 50
"""Each vehicle is six series; a fleet is told apart by `counterpoint rates`, not by metrics."""

AGREEMENTS: Final = tuple(agreement.name.lower() for agreement in Agreement)

SCORE_BUCKETS: Final = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
COMMIT_BUCKETS_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0)
"""Around the few milliseconds that a durable commit takes on a disk of its own."""

Metric = TypeVar("Metric", Counter, Gauge, Histogram)


class ServiceMetrics:
    """What the service counts; a `StoreObserver` that the ledger tells of every transaction."""

    def __init__(
        self, registry: CollectorRegistry | None = None, *, vehicles: Sequence[str] = ()
    ) -> None:
        """Make every series at once, so that each is there from the first scrape on.

        Args:
            registry: Where to register; by default one of its own.
            vehicles: Those that have series of their own, at most `MOST_VEHICLES`; all others
                count as `other`.
        """
        # A second series for each counter, which nobody asks for.
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
            "Scenes stored, each once, by what may be made of their score. Worry when the share of "
            "`odometry_lost` grows: poses fail, and those scenes rank last unseen.",
            state=tuple(SceneState),
        )
        self._points = self._counter(
            "points",
            "Points of stored scenes by agreement of the two streams, each once. The disagreement "
            "rate is the rate of the two `only_` ones over that of all but `not_compared`. Worry "
            "when it leaves its usual band: a model, a sensor or a calibration has changed.",
            agreement=AGREEMENTS,
        )
        self._tracks = self._counter(
            "contradicting_tracks",
            "Things on which the streams contradict each other, followed over a scene, by which "
            "stream alone calls them dynamic. Worry when one kind grows against the other: that "
            "stream has changed.",
            kind=tuple(ContradictionKind),
        )
        self._instances = self._counter(
            "contradicting_instances",
            "Contradicting clusters over all frames, by which stream alone calls them dynamic. "
            "Worry when it grows and the tracks do not: flicker rather than things.",
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
            "Scenes stored by vehicle; those not in the setting `vehicles` are `other`. Worry when "
            "one falls silent.",
            vehicle=by_vehicle,
        )
        self._vehicle_points = self._counter(
            "vehicle_points",
            "Points by vehicle and agreement; as counterpoint_points_total. Worry when one "
            "vehicle's disagreement leaves that of the others: its sensor or calibration.",
            vehicle=by_vehicle,
            agreement=AGREEMENTS,
        )
        self._commits = self._counter(
            "commits",
            "Commits of plans and shards by answer. Worry when `refused` grows (the log says "
            "why), or `missing` beyond a few percent: records are lost on the bus.",
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
            "Leases that ended, by why. Worry when `expired`, `failed` or `worker_died` grow: each "
            "is an attempt lost, and the last one parks the work.",
            reason=get_args(LeaseEnd),
        )
        self._parked = self._counter(
            "work_parked",
            "Plans and shards parked: not tried again until `counterpoint retry`. Worry at any "
            "growth; `counterpoint status` names each with its error.",
            work=get_args(WorkKind),
        )
        self._retried = self._counter(
            "work_retried",
            "Parked plans and shards that are tried again, by `counterpoint retry`. Worry when "
            "those parked grow after it: what made them fail is still there.",
            work=get_args(WorkKind),
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
            "Transactions that the database could not finish. Worry at any growth: disk full, "
            "database locked, or its server away; nothing acknowledged is lost.",
        )
        self._damaged_records = self._counter(
            "damaged_records",
            "Stored records that are not what their digest says, each once. Worry at any: the disk "
            "of the database damages what lies on it; the log names them, and none is shown.",
        )
        self._faults = self._counter(
            "faults",
            "Unforeseen errors, by what they met: `question` an answer, `tick` work that "
            "is done again and again, `event` a scene that the bus cannot carry, left out. The "
            "service goes on. Worry at any growth: the log has the trace.",
            part=get_args(FaultyPart),
        )
        self._gauges: ServiceGauges | None = None
        build = Gauge(
            "build_info",
            "1; its label says which version runs.",
            ("version",),
            NAMESPACE,
            registry=self.registry,
        )
        build.labels(version("counterpoint")).set(1)

    def on_effects(self, effects: Effects) -> None:
        """Count what a transaction did, now that it is on disk."""
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

    def on_database_error(self) -> None:
        """Count a transaction that could not be finished."""
        self._database_errors.inc()

    def on_damaged_record(self) -> None:
        """Count a stored record that is damaged."""
        self._damaged_records.inc()

    def committed(self, seconds: float) -> None:
        """Note how long it took to make a commit durable."""
        self._commit_seconds.observe(seconds)

    def asked(self, verb: str, outcome: Outcome) -> None:
        """Count a question."""
        self._questions.labels(verb, outcome).inc()

    def faulted(self, part: FaultyPart) -> None:
        """Count an error that nobody foresaw."""
        self._faults.labels(part).inc()

    def read_from(self, sources: Sources) -> None:
        """Also serve what is read at the time of a scrape; said again: read elsewhere."""
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
    """Make the series of every combination of labels: a rate needs a zero to rise from."""
    if labels:
        for combination in product(*labels.values()):
            metric.labels(*combination)
    return metric
