"""Ledger of every recording, shard and scene; whatever it acknowledges is on disk."""

import math
import uuid
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final

import structlog
from sqlalchemy import Connection

from schemas.work import (
    Answer,
    ClaimReply,
    ClaimRequest,
    CommitRequest,
    FailRequest,
    MineLease,
    NothingToDo,
    PlanLease,
    Recording,
    RenewRequest,
)
from service.curation.activity import ActivityReply, ActivityRequest
from service.curation.listing import ScenesReply, ScenesRequest
from service.curation.ranking import RankedScene
from service.curation.rates import RatesRequest, RateSums
from service.curation.status import ParkedWork, SkippedEntries, Status
from service.curation.verdicts import ChoicesReply
from service.store import (
    activity,
    audit,
    backlog,
    claims,
    commits,
    events,
    leases,
    listing,
    manifest,
    overview,
    ranking,
    rates,
    recordings,
    retrying,
    scenes,
    served_bucket,
    skipped_entries,
)
from service.store.backlog import Backlog
from service.store.comparisons import Comparisons
from service.store.engine import Store
from service.store.leases import LeasePolicy
from service.store.proposals import Proposals
from service.store.recordings import SyncResult
from service.store.remining import ReminingPolicy, Turns
from service.store.retired_overlays import RetiredOverlays
from service.store.scenes import StoredScene
from service.store.selections import Selections
from service.store.transaction_effects import StoreObserver
from service.store.verdicts import Verdicts
from service.store.versions import NewVersion, enter_version
from service.store.webhooks import Webhooks

__all__ = ["LeasePolicy", "Ledger", "StoredScene"]

PROOF_INTERVAL_S: Final = 30.0
"""Interval at which an idle daemon proves that the database can be written, seconds."""

PRUNE_INTERVAL_S: Final = 3600.0
"""Interval of the deletion of old leases, seconds."""

log = structlog.get_logger(__name__)


class Ledger:
    """Ledger on a store; every write is one transaction, and is on disk when it returns.

    May be called from any thread: writers take turns on the store's one lock (SQLite allows only
    one writer), readers never wait and see the last commit.

    Attributes:
        retired_overlays: Overlays that are no longer needed, and since when.
        selections: Stored selections.
        proposals: Choices of scenes for new ones.
        comparisons: Comparisons of two versions.
        verdicts: Stored verdicts; `audit_log`: who did what, and when; `webhooks`: events.

    Raises (every method):
        StoreUnavailableError: Transient: disk full, database locked for too long.
        StatementFailedError: Permanent: the database can never take this request.
        StateUnusableError: Permanent: the database is damaged, or not the one that was opened.
    """

    def __init__(
        self,
        store: Store,
        *,
        now_s: Callable[[], float],
        policy: LeasePolicy | None = None,
        remine: ReminingPolicy | None = None,
        new_lease_id: Callable[[], str] = lambda: uuid.uuid4().hex,
    ) -> None:
        """Keep the store, the clock and the terms of leases.

        Args:
            store: The database, open for writing, or only for reading if nothing is written.
            now_s: Clock in seconds, best the wall clock, since leases outlive the process. It may
                step, by which leases at worst end early or last one term more.
            policy: Terms of leases and of parking.
            remine: Order of logs, and which are mined again under a new pipeline version.
            new_lease_id: Returns a unique id for a lease.
        """
        self._store, self._now_s, self._policy = store, now_s, policy or LeasePolicy()
        self._turns = Turns(remine or ReminingPolicy())
        self._new_lease_id = new_lease_id
        self.retired_overlays = RetiredOverlays(store, now_s=now_s)
        self.selections = Selections(store, now_s=now_s)
        self.proposals = Proposals(store)
        self.comparisons = Comparisons(store)
        self.verdicts = Verdicts(store, now_s=now_s)
        self.webhooks = Webhooks(store, now_s=now_s)
        self.audit_log = audit.AuditLog(store, now_s=now_s)
        self._listing = 0
        """Number of listings received, from which claims know that plans may be missing."""
        self._seeded: dict[str, int] = {}
        """Last listing for which each pipeline version has every plan."""
        self._pruned_s = self._proved_s = -math.inf

    def now_s(self) -> float:
        """Return the time of the clock for everything durable, seconds."""
        return self._now_s()

    @property
    def cannot_write(self) -> str:
        """Error of the last write; empty: writing works."""
        return self._store.cannot_write

    def observe(self, observer: StoreObserver) -> None:
        """Add an observer, which is called after each transaction."""
        self._store.observe(observer)

    # What lies in the bucket.

    def serve_bucket(self, url: str, listed: Sequence[Recording]) -> None:
        """Check that this is the bucket whose logs are recorded here.

        Call it before the first listing is received, which withdraws the scenes of all logs that
        are not in it.

        Raises:
            OtherBucketError: If it is another one.
        """
        with self._store.writing() as connection:
            if not served_bucket.require_served(connection, url, listed, name=self._store.name):
                served_bucket.note_served(connection, url)

    def sync_recordings(
        self, listed: Sequence[Recording], *, among: Collection[str] | None = None
    ) -> SyncResult:
        """Apply a complete listing, or one of the logs `among` alone: what is new or gone.

        Raises:
            ValueError: If two of them have one log id.
        """
        known = recordings.by_log(listed)
        with self._store.writing() as within:
            self._listing += 1
            return recordings.sync_recordings(within, known, now_s=self._now_s(), among=among)

    def note_skipped(self, skipped: SkippedEntries) -> None:
        """Note the entries of the bucket that the last listing skipped."""
        with self._store.writing() as connection:
            skipped_entries.note_skipped(connection, skipped)

    def has_recordings(self) -> bool:
        """Return true if the last listing contained a recording."""
        with self._store.reading() as connection:
            return recordings.has_recordings(connection)

    def stale_logs(self) -> list[str]:
        """Return logs that changed under a reader; the next `sync_recordings` decides on them."""
        with self._store.reading() as connection:
            return recordings.stale_logs(connection)

    # Leases.

    def resume(self) -> None:
        """Extend held leases to a full term, after a time in which nothing could renew them."""
        with self._store.writing() as connection:
            leases.resume(connection, now_s=self._now_s(), policy=self._policy)

    def claim(self, request: ClaimRequest) -> ClaimReply:
        """Lease a recording to plan or a shard to mine.

        Work of a pipeline version exists because one of its workers asks. `expires_s` of the grant
        is the duration of the lease from the answer on, since clocks of machines differ.
        """
        version = request.pipeline_version

        def granted(
            connection: Connection,
        ) -> tuple[int, NewVersion | None, PlanLease | MineLease | NothingToDo]:
            listing, new = self._listing, None
            if self._seeded.get(version) != listing:
                first = version not in self._seeded
                new = enter_version(connection, version, request.layers, self._turns, first=first)
            grant = claims.claim(
                connection,
                request,
                now_s=self._now_s(),
                policy=self._policy,
                lease_id=self._new_lease_id(),
                turns=self._turns.open(connection, version, now_s=self._now_s()),
            )
            return listing, new, grant

        self._seeded[version], new, grant = self._store.write(granted)
        if new is not None:
            new.tell(mode=self._turns.policy.mode)
        return ClaimReply(grant=grant)

    def lease_problem(self, *, worker_id: str, lease_id: str) -> str:
        """Return why a worker cannot use a lease, by reading alone; empty: it is the worker's."""
        with self._store.reading() as connection:
            lease = leases.lease_of(connection, lease_id, worker_id=worker_id)
        return lease if isinstance(lease, str) else ""

    def renew(self, request: RenewRequest) -> Answer:
        """Extend a lease; not ok: it is over, and its worker must stop."""
        return self._store.write(
            lambda within: leases.renew(within, request, now_s=self._now_s(), policy=self._policy)
        )

    def commit(self, request: CommitRequest, staged: Mapping[str, bytes]) -> Answer:
        """Finish a lease, whole or not at all.

        Args:
            request: A plan, or the manifest of a mined shard.
            staged: Records that arrived on the bus, by digest.

        Returns:
            ok: it is on disk, perhaps since an earlier commit. `missing`: send those records along
            and ask again. `problem`: it can never be accepted, since the work is void or wrong.
        """
        verified = manifest.verify(request, staged)
        return self._store.write(
            lambda within: commits.commit(
                within, request, verified, now_s=self._now_s(), lanes=self._turns.lanes
            )
        )

    def fail(self, request: FailRequest) -> Answer:
        """End a lease with its error; its work is retried later, or parked."""
        return self._store.write(
            lambda within: leases.fail(within, request, now_s=self._now_s(), policy=self._policy)
        )

    def expire(self) -> int:
        """End leases whose time is over, as if their workers had died; call each second.

        At intervals it also deletes leases that ended days ago, and proves that the database can
        still be written.

        Returns:
            Number of ended leases.
        """
        now_s = self._now_s()
        proves = abs(now_s - self._proved_s) >= PROOF_INTERVAL_S
        with self._store.writing(proves=proves) as connection:
            if abs(now_s - self._pruned_s) >= PRUNE_INTERVAL_S:
                leases.prune(connection, now_s=now_s)
                self._pruned_s = now_s
            expired = leases.expire(connection, now_s=now_s, policy=self._policy)
        if proves:
            self._proved_s = now_s
        return expired

    def free_leases(self, worker_prefix: str) -> int:
        """End the leases of workers with this id prefix, without counting an attempt."""
        with self._store.writing() as connection:
            return leases.free_leases(connection, worker_prefix)

    def worker_died(self, worker_id: str) -> int:
        """End the leases of one dead worker; count attempts where the work may have killed it."""
        with self._store.writing() as connection:
            return leases.worker_died(
                connection, worker_id, now_s=self._now_s(), policy=self._policy
            )

    def retry(
        self, log_ids: Sequence[str] | None = None, *, refused: bool = False
    ) -> list[ParkedWork]:
        """Open parked work, of these logs or all, or all refused plans again, and return it.

        Raises:
            NothingFoundError: If one of these logs is not in the bucket; then nothing is changed.
        """
        with self._store.writing() as connection:
            retried = retrying.retry(connection, log_ids, refused=refused)
            audit.retried(connection, retried, now_s=self._now_s())
            return retried

    def pipeline_versions(self) -> list[str]:
        """Return the registered pipeline versions, the oldest first."""
        with self._store.reading() as connection:
            return recordings.pipeline_versions(connection)

    # Scenes and outbox.

    def unpublished(self, limit: int) -> list[StoredScene]:
        """Return events after the cursor in the order of their numbers, including withdrawals."""
        with self._store.reading() as connection:
            return scenes.unpublished(connection, limit=limit, on_damaged=self._store.note_damaged)

    def mark_published(self, seq: int) -> None:
        """Move the cursor forward, durably: everything up to `seq` is published."""
        with self._store.writing() as connection:
            events.mark_published(connection, seq)

    def last_seq(self) -> int:
        """Return the number of the newest event, 0 when there is none."""
        with self._store.reading() as connection:
            return events.counter(connection, "seq")

    def scenes_since(self, seq: int, limit: int | None = None) -> list[StoredScene]:
        """Return current scenes with a greater number, in the order of their numbers."""
        with self._store.reading() as connection:
            return scenes.current_scenes(
                connection, after=seq, limit=limit, on_damaged=self._store.note_damaged
            )

    def events_since(self, seq: int, limit: int) -> list[StoredScene]:
        """Return current scenes and withdrawals with a greater number, in that order."""
        with self._store.reading() as connection:
            return scenes.events_since(
                connection, after=seq, limit=limit, on_damaged=self._store.note_damaged
            )

    def newest_scenes(self, limit: int) -> list[StoredScene]:
        """Return the current scenes with the highest numbers, in the order of their numbers."""
        with self._store.reading() as connection:
            return scenes.current_scenes(
                connection, limit=limit, newest=True, on_damaged=self._store.note_damaged
            )

    def current_scenes(self) -> list[StoredScene]:
        """Return every current scene, in the order of their numbers."""
        with self._store.reading() as connection:
            return scenes.current_scenes(connection, on_damaged=self._store.note_damaged)

    def scene(self, scene_id: str, *, withdrawn: bool = False) -> StoredScene | None:
        """Return a current scene, or with `withdrawn` its last record; raise as `scenes` does."""
        find = scenes.last_scene if withdrawn else scenes.current_scene
        with self._store.reading() as connection:
            return find(connection, scene_id, on_damaged=self._store.note_damaged)

    def ranking(self, *, most: int | None = None) -> list[RankedScene]:
        """Rank current scenes, best first, and return at most `most`; None: all."""
        with self._store.reading() as connection:
            return list(ranking.ranked(connection, most=most, on_damaged=self._store.note_damaged))

    def listing(self, request: ScenesRequest) -> ScenesReply:
        """Return a page of current scenes by filter and order, or raise as `listing.page` does."""
        with self._store.reading() as connection:
            return listing.page(connection, request, on_damaged=self._store.note_damaged)

    def activity(self, request: ActivityRequest) -> ActivityReply:
        """Return scenes, disagreement, verdicts and precision over time and by group."""
        with self._store.reading() as connection:
            return activity.activity(connection, request)

    def choices(self, *, causes: Sequence[str] = ()) -> ChoicesReply:
        """Return the values that filters and verdicts choose from; `causes` are the user's own."""
        with self._store.reading() as connection:
            return activity.choices(connection, causes=causes)

    def rate_sums(self, request: RatesRequest) -> list[RateSums]:
        """Return sums over the requested groups of current scenes, in no order."""
        with self._store.reading() as connection:
            return rates.rate_sums(connection, request)

    # How far it is.

    def backlog(self) -> Backlog:
        """Count waiting, running and parked work, under the newest pipeline version."""
        with self._store.reading() as connection:
            return backlog.backlog(connection, self._turns.policy, now_s=self._now_s())

    def status(self, pipeline_version: str | None = None) -> Status:
        """Return the progress of all work under this pipeline version; by default the newest."""
        with self._store.reading() as connection:
            return overview.status(connection, pipeline_version, now_s=self._now_s())

    def settled(self, pipeline_version: str) -> bool:
        """Return true if no work is left under this pipeline version.

        That is the case when every current recording is planned, refused or parked, and every shard
        done or parked.
        """
        with self._store.reading() as connection:
            return overview.settled(connection, pipeline_version)
