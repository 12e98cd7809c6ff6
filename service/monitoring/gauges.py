"""Gauges of the service: metrics that are read at the time of a scrape instead of counted."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import Final, Literal, Protocol, get_args

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from schemas.errors import CounterpointError
from service.background.bucket_watch import BucketSeen
from service.store.backlog import Backlog, LogDamage
from service.store.transaction_effects import WorkKind
from service.store.verdict_rows import JudgedOutcome
from service.store.work_items import WorkState

BucketError = Literal["unreachable", "refused"]
"""Cause of an interrupted listing. `unreachable`: no answer, an error of the store's own, or a
missing folder, as when its disk is not mounted. `refused`: the store denied it.
"""

ClockStep = Literal["forward", "back"]
"""Direction of a clock step."""

NAMESPACE: Final = "counterpoint"

CACHED_S: Final = 5.0
"""Least interval between two counts of the ledger, however many scrapes there are, seconds."""

RECORDING_STATES: Final = (
    "waiting",
    "settling",
    "planning",
    "mining",
    "resting",
    "done",
    "refused",
    "parked",
    "stale",
    "kept",
    "same",
)


class ArtifactsUse(Protocol):
    """Bytes of the overlays, as last listed, and their budget."""

    @property
    def used_bytes(self) -> int | None:
        """Bytes that they use; None before the first listing."""
        ...

    @property
    def budget_bytes(self) -> int:
        """Most bytes."""
        ...


@dataclass(frozen=True, slots=True)
class Sources:
    """Sources of the gauges; each call must be quick.

    Attributes:
        backlog: Counts of the ledger; may raise a `CounterpointError`.
        bucket_url: URL of the log bucket.
        bucket: Results of its listings.
        staging_bytes: Bytes of raw records that wait for their commit.
        questions_waiting: Requests in the queue.
        bus_misses: Raw records that were lost on the bus so far.
        state_free_bytes: Free bytes on the disk of the state; None: unknown.
        router_connected: True if a router is connected.
        clock_steps: Number of clock steps, by direction.
        bucket_notices: Objects that notices of the bucket named; None: it takes none.
        overlays_deleted: Overlays deleted since the start.
        artifacts: Bytes of the overlays and their budget; None without one.
        webhooks_late_s: Time for which the worst receiver of webhooks has failed, seconds.
        standbys: Services that stand by; None: none is expected.
        now_s: Seconds since the Unix epoch.
    """

    backlog: Callable[[], Backlog] = Backlog
    bucket_url: str = ""
    bucket: Callable[[], BucketSeen] = BucketSeen
    staging_bytes: Callable[[], int] = lambda: 0
    questions_waiting: Callable[[], int] = lambda: 0
    bus_misses: Callable[[], int] = lambda: 0
    state_free_bytes: Callable[[], int | None] = lambda: None
    router_connected: Callable[[], bool] = lambda: False
    clock_steps: Callable[[], Mapping[str, int]] = lambda: {}
    bucket_notices: Callable[[], int | None] = lambda: None
    overlays_deleted: Callable[[], int] = lambda: 0
    artifacts: Callable[[], ArtifactsUse | None] = lambda: None
    webhooks_late_s: Callable[[], float] = lambda: 0.0
    standbys: Callable[[], int | None] = lambda: None
    now_s: Callable[[], float] = lambda: 0.0


@dataclass(slots=True)
class _Kept:
    """Last count of the ledger, and its time on the monotonic clock."""

    at_s: float = float("-inf")
    backlog: Backlog | None = None
    lock: Lock = field(default_factory=Lock)


class ServiceGauges(Collector):
    """Reads the gauges, once per scrape.

    While the database does not answer, its series are absent; `counterpoint_database_errors_total`
    gives the cause.
    """

    def __init__(self, sources: Sources) -> None:
        """Keep the sources; nothing is read before the first scrape."""
        self._sources, self._kept = sources, _Kept()

    def read_from(self, sources: Sources) -> None:
        """Replace the sources."""
        self._sources = sources

    def describe(self) -> Iterator[Metric]:
        """Describe the metrics without reading any, as a registry asks at registration."""
        yield from _of_ledger(Backlog(), now_s=0.0)
        yield from _of_parts(Sources())

    def collect(self) -> Iterator[Metric]:
        """Read all sources now; counts of the ledger are at most `CACHED_S` old."""
        backlog = self._backlog()
        if backlog is not None:
            yield from _of_ledger(backlog, now_s=self._sources.now_s())
        yield from _of_parts(self._sources)

    def _backlog(self) -> Backlog | None:
        with self._kept.lock:
            now_s = time.monotonic()
            if now_s - self._kept.at_s >= CACHED_S:
                try:
                    self._kept.backlog = self._sources.backlog()
                except CounterpointError:  # away or damaged; the store's observer has counted it
                    self._kept.backlog = None
                self._kept.at_s = now_s
            return self._kept.backlog


def _of_ledger(backlog: Backlog, *, now_s: float) -> Iterator[Metric]:
    yield _gauge(
        "work",
        "Plans and shards under the newest pipeline version, by state; `done` also counts those of "
        "recordings since replaced. Worry when `ready` only grows: too few workers; and at any "
        "`parked`, which is not tried again until `counterpoint retry`.",
        {
            (work, state.value): backlog.work.get((work, state.value), 0)
            for work in get_args(WorkKind)
            for state in WorkState
        },
        labels=("work", "state"),
    )
    yield _gauge(
        "recordings",
        "Recordings in the bucket by state; `resting` ones are mined again when the day's "
        "`remine_core_hours_a_day` are not used up any more. Worry at any `refused` or `parked`: "
        "`counterpoint status` names each with its problem.",
        {(state,): backlog.recordings.get(state, 0) for state in RECORDING_STATES},
        labels=("state",),
    )
    yield _gauge(
        "damaged_recordings",
        "Recordings in the bucket that are mined only in part, each once. `truncated` ones have "
        "an object that was never closed, and are mined up to its end; `unreadable` ones have "
        "stretches that cannot be read. Worry when it grows: uploads are interrupted, or a "
        "recorder loses data; `counterpoint status` names each.",
        {(damage,): backlog.damaged.get(damage, 0) for damage in get_args(LogDamage)},
        labels=("damage",),
    )
    yield _gauge(
        "damaged_stretches",
        "Unreadable stretches of the recordings in the bucket, mostly one chunk each; each is "
        "counted once over all pipeline versions. Worry when it grows: a recorder or an upload "
        "loses data; `counterpoint status` names each.",
        backlog.damaged_stretches,
    )
    yield _gauge(
        "noticed_recordings",
        "Recordings in the bucket of which something was noticed that costs no byte of them, such "
        "as answers of a model that cannot be used. Worry when it grows: what cannot be used is "
        "not compared, and cannot rank; `counterpoint status` names each.",
        backlog.noticed,
    )
    oldest = backlog.oldest_listed_s
    yield _gauge(
        "oldest_work_age_seconds",
        "Time since the oldest recording with work left, unless it rests, was first listed; 0 when "
        "none is left. "
        "Worry when it exceeds the time of mining one recording: the workers do not keep up, or "
        "are gone.",
        0.0 if oldest is None else max(0.0, now_s - oldest),
    )
    yield _gauge(
        "remined_core_seconds",
        "Seconds of a core that mining logs again took within the last day, as far as committed. "
        "Worry when it stays far below `remine_core_hours_a_day` while logs wait: too few workers.",
        backlog.remined_s,
    )
    yield _gauge("leases_held", "Leases held now.", backlog.leases_held)
    yield _gauge(
        "workers_seen",
        "Workers that hold a lease now. Worry when 0 while work is `ready`.",
        backlog.workers,
    )
    yield _gauge("current_scenes", "Current scenes, which are ranked.", backlog.current_scenes)
    yield _gauge(
        "judged_scenes",
        "Scenes on which a reviewer decided which stream is wrong; `right`: the supervised one, "
        "alone or with the other. The precision of the ranking so far is `right` over both. Worry "
        "when its share of `right` falls: reviewers look at scenes in vain.",
        {(outcome,): backlog.judged_scenes.get(outcome, 0) for outcome in get_args(JudgedOutcome)},
        labels=("outcome",),
    )
    yield _gauge(
        "unpublished_events",
        "Scene events on disk that the outbox has not published yet. Worry when it only grows: "
        "no router is connected.",
        backlog.unpublished,
    )


def active_gauge(*, is_active: bool) -> Metric:
    """Make the gauge that is 1 for the active service."""
    return _gauge(
        "service_active",
        "1 for the service that serves, 0 for one that stands by. Worry when no instance has 1: "
        "nothing is leased, committed or published.",
        int(is_active),
    )


def _of_parts(sources: Sources) -> Iterator[Metric]:
    seen = sources.bucket()
    yield _gauge(
        "bucket_last_listing_timestamp_seconds",
        "Time of the last successful listing of the bucket, since the Unix epoch; 0: not yet. "
        "Worry when older than a few list_interval_s: new logs are not seen.",
        {(sources.bucket_url,): seen.last_success_s or 0.0},
        labels=("bucket",),
    )
    yield _gauge(
        "bucket_listing_seconds",
        "Duration of the last complete listing. Worry when it nears list_interval_s.",
        seen.duration_s,
    )
    yield _gauge(
        "bucket_skipped_entries",
        "Entries that the last listing skipped because they cannot be logs: a name with control "
        "characters, a loop of links, a folder that may not be read. Worry when it grows: the "
        "service's log names each.",
        seen.skipped,
    )
    yield _gauge(
        "bucket_objects",
        "Objects of recordings in the bucket at the last listing. Worry when it falls "
        "unexpectedly.",
        seen.objects,
    )
    yield _gauge(
        "bucket_bytes",
        "Bytes of recordings in the bucket at the last listing. Worry when it falls unexpectedly.",
        seen.bytes,
    )
    yield _counter(
        "bucket_errors",
        "Interrupted listings. Worry when it grows for minutes. `unreachable` means the network, "
        "the store, or a missing folder; `refused` means credentials, or a missing bucket.",
        {(kind,): seen.errors.get(kind, 0) for kind in get_args(BucketError)},
        labels=("kind",),
    )
    yield _gauge(
        "staging_bytes",
        "Memory of raw records that wait for their commit. Worry near 64 MiB: the oldest are "
        "dropped then, and sent again.",
        sources.staging_bytes(),
    )
    yield _gauge(
        "questions_waiting",
        "Requests in the queue. Worry when it stays above some hundred: the disk of the state is "
        "too slow for so many workers.",
        sources.questions_waiting(),
    )
    yield _counter(
        "bus_misses",
        "Raw records lost between a worker and the service; the commit names them, and they are "
        "sent again. Worry when it grows steadily: the network or the router drops messages.",
        {(): sources.bus_misses()},
    )
    yield _gauge(
        "router_connected",
        "1 while a router is connected, else 0. Worry at 0 for a minute: no worker is answered, "
        "no scene published; workers keep their results.",
        int(sources.router_connected()),
    )
    steps = sources.clock_steps()
    yield _counter(
        "clock_steps",
        "Steps of the clock of the service's machine by seconds, including suspensions. Worry "
        "when it grows: ages and rates count from wrong times. Leases are extended by a term.",
        {(way,): steps.get(way, 0) for way in get_args(ClockStep)},
        labels=("direction",),
    )
    yield _counter(
        "bucket_notices",
        "Objects that notices named; absent without `bucket_notices`. Worry when it stands "
        "still while listings find new logs: the store sends no notices.",
        {} if (named := sources.bucket_notices()) is None else {(): named},
    )
    yield _counter(
        "overlays_deleted",
        "Overlays deleted from the artifacts, of scenes withdrawn `keep_withdrawn_days` ago, or "
        "beyond `artifacts_budget_bytes`; 0 without these settings. Worry when it stays 0 with "
        "one, and the artifacts only grow: the log has the cause.",
        {(): sources.overlays_deleted()},
    )
    yield _gauge(
        "webhooks_late_seconds",
        "Time for which an event waits that a receiver of `webhooks` does not take, of the worst "
        "receiver; 0: none waits. Worry above 600 s: the log has the host and the cause.",
        {(): sources.webhooks_late_s()},
    )
    yield active_gauge(is_active=True)
    standbys = sources.standbys()
    yield _gauge(
        "service_standbys",
        "Services that stand by for this one; only where `standby` is set. Worry at 0 for minutes: "
        "none takes over when this one ends.",
        {} if standbys is None else {(): standbys},
    )
    yield from _artifacts(sources.artifacts())
    free = sources.state_free_bytes()
    yield _gauge(
        "state_free_bytes",
        "Free bytes on the disk of the state folder. Worry below 1 GB: a full disk accepts no "
        "commit.",
        {} if free is None else {(): free},
    )


def _artifacts(use: ArtifactsUse | None) -> Iterator[Metric]:
    used = None if use is None else use.used_bytes
    yield _gauge(
        "artifacts_bytes",
        "Bytes of the overlays at the last look for `artifacts_budget_bytes`; absent without that "
        "setting. Worry when it exceeds the budget: what is left is selected, judged or kept.",
        {} if used is None else {(): used},
    )
    yield _gauge(
        "artifacts_budget_bytes",
        "The setting `artifacts_budget_bytes`; absent without it. Worry when it is smaller than "
        "the overlays that have to stay.",
        {} if use is None else {(): use.budget_bytes},
    )


def _gauge(
    name: str,
    help_: str,
    values: Mapping[tuple[str, ...], float] | float,
    *,
    labels: Sequence[str] = (),
) -> Metric:
    family = GaugeMetricFamily(f"{NAMESPACE}_{name}", help_, labels=labels)
    for label_values, value in (
        {(): values} if isinstance(values, int | float) else values
    ).items():
        family.add_metric(label_values, value)
    return family


def _counter(
    name: str,
    help_: str,
    values: Mapping[tuple[str, ...], float],
    *,
    labels: Sequence[str] = (),
) -> Metric:
    family = CounterMetricFamily(f"{NAMESPACE}_{name}", help_, labels=labels)
    for label_values, value in values.items():
        family.add_metric(label_values, value)
    return family
