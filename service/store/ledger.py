"""The record of every recording, shard and scene: what was acknowledged here is on disk."""

import math
import uuid
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
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
from service.curation.ranking import RankedScene
from service.curation.rates import RatesRequest, RateSums
from service.curation.selection import Selection
from service.curation.status import ParkedWork, Status
from service.curation.strategies.catalogue import DEFAULT, select
from service.store import (
    backlog,
    claims,
    commits,
    events,
    leases,
    manifest,
    overview,
    ranking,
    rates,
    recordings,
    retrying,
    scenes,
    selections,
    served_bucket,
)
from service.store.backlog import Backlog
from service.store.engine import Store
from service.store.leases import LeasePolicy
from service.store.recordings import SyncResult
from service.store.retired_overlays import RetiredOverlays
from service.store.scenes import StoredScene
from service.store.transaction_effects import StoreObserver

__all__ = ["LeasePolicy", "Ledger", "StoredScene"]

PROOF_INTERVAL_S: Final = 30.0
"""A daemon with nothing to write finds out within this whether it could."""

PRUNE_INTERVAL_S: Final = 3600.0
"""Between two looks at all leases for those that may be forgotten."""

log = structlog.get_logger(__name__)


class Ledger:
    """Every write is one transaction, and returns after it is on disk.

    May be called from any thread: writers wait for each other on the store's one lock (one writer
    is what SQLite allows anyway), readers wait for nobody and see the last commit.

    Attributes:
        retired_overlays: Since when which overlays are not needed any more.

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
        new_lease_id: Callable[[], str] = lambda: uuid.uuid4().hex,
    ) -> None:
        """Take what the ledger needs of the world.

        Args:
            store: The database, open for writing; to read it, one open for reading will do.
            now_s: A clock in seconds, best the wall clock: leases outlive the process. It may
                step, which at worst lets leases end early or last one term more.
            policy: Terms of leases and of parking.
            new_lease_id: Names a lease like no other before.
        """
        self._store, self._now_s, self._policy = store, now_s, policy or LeasePolicy()
        self._new_lease_id = new_lease_id
        self.retired_overlays = RetiredOverlays(store, now_s=now_s)
        self._listing = 0
        """Counts the listings taken over, so that claims know whether plans may be wanting."""
        self._seeded: dict[str, int] = {}
        """Pipeline version to the listing for which it is known to have every plan."""
        self._pruned_s = self._proved_s = -math.inf

    def now_s(self) -> float:
        """Read the clock that everything durable goes by."""
        return self._now_s()

    @property
    def cannot_write(self) -> str:
        """Why the last write failed, if none has worked since; empty: writing works."""
        return self._store.cannot_write

    def observe(self, observer: StoreObserver) -> None:
        """Tell one observer, after each transaction, what it did."""
        self._store.observe(observer)

    # What lies in the bucket.

    def serve_bucket(self, url: str, listed: Sequence[Recording]) -> None:
        """Make sure that this is the bucket whose logs are recorded here.

        Call it before its first listing is taken over: that withdraws the scenes of all logs that
        are not in it.

        Raises:
            OtherBucketError: If it is another one.
        """
        with self._store.writing() as connection:
            if not served_bucket.require_served(connection, url, listed, name=self._store.name):
                served_bucket.note_served(connection, url)

    def sync_recordings(self, listed: Sequence[Recording]) -> SyncResult:
        """Take over a complete listing: new, replaced and deleted recordings.

        Raises:
            ValueError: If two of them have one log id.
        """
        by_log = recordings.by_log(listed)
        with self._store.writing() as connection:
            self._listing += 1
            return recordings.sync_recordings(connection, by_log, now_s=self._now_s())

    def has_recordings(self) -> bool:
        """Whether the last listing that was taken over held any recording."""
        with self._store.reading() as connection:
            return recordings.has_recordings(connection)

    def stale_logs(self) -> list[str]:
        """Logs whose object changed under a reader: the next `sync_recordings` decides on them."""
        with self._store.reading() as connection:
            return recordings.stale_logs(connection)

    # Leases.

    def resume(self) -> None:
        """Call once when a service starts: held leases get a full term, nobody could renew them."""
        with self._store.writing() as connection:
            leases.resume(connection, now_s=self._now_s(), policy=self._policy)

    def register_pipeline(self, pipeline_version: str) -> None:
        """Note a pipeline version; the one first seen last is the newest. `claim` does it too."""
        with self._store.writing() as connection:
            recordings.register_pipeline(connection, pipeline_version)

    def claim(self, request: ClaimRequest) -> ClaimReply:
        """Lease a recording to plan or a shard to mine.

        Work under a pipeline version exists because one of its workers asks. `expires_s` of the
        grant is the term of the lease, counted from the answer: clocks of machines differ.
        """
        version = request.pipeline_version

        def granted(
            connection: Connection,
        ) -> tuple[int, str, PlanLease | MineLease | NothingToDo]:
            listing, before = self._listing, ""
            if self._seeded.get(version) != listing:
                before = recordings.register_pipeline(connection, version)
                recordings.seed_plans(connection, version)
            grant = claims.claim(
                connection,
                request,
                now_s=self._now_s(),
                policy=self._policy,
                lease_id=self._new_lease_id(),
            )
            return listing, before, grant

        self._seeded[version], before, grant = self._store.write(granted)
        if before:
            log.warning(
                "new pipeline version: every log is mined anew",
                pipeline_version=version,
                before=before,
            )
        return ClaimReply(grant=grant)

    def renew(self, request: RenewRequest) -> Answer:
        """Lengthen a lease; not ok: it is over, stop working on it."""
        return self._store.write(
            lambda connection: leases.renew(
                connection, request, now_s=self._now_s(), policy=self._policy
            )
        )

    def commit(self, request: CommitRequest, staged: Mapping[str, bytes]) -> Answer:
        """Finish a lease, whole or not at all.

        Args:
            request: A plan, or the manifest of a mined shard.
            staged: Digest to bytes, of the records that arrived on the bus.

        Returns:
            ok: it is on disk, also when it was already. `missing`: send those records along and
            ask again. `problem`: it can never be taken, the work is void or wrong.
        """
        verified = manifest.verify(request, staged)
        return self._store.write(
            lambda connection: commits.commit(connection, request, verified, now_s=self._now_s())
        )

    def fail(self, request: FailRequest) -> Answer:
        """Take a lease back with its error: tried again later, or parked."""
        return self._store.write(
            lambda connection: leases.fail(
                connection, request, now_s=self._now_s(), policy=self._policy
            )
        )

    def expire(self) -> int:
        """Take back leases whose time is over, as if their workers had died; call each second.

        Now and then it also forgets leases that ended days ago, and proves that the database can
        still be written.

        Returns:
            How many there were.
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
        """Take back leases of workers whose ids begin so, attempt not counted."""
        with self._store.writing() as connection:
            return leases.free_leases(connection, worker_prefix)

    def worker_died(self, worker_id: str) -> int:
        """Take back the leases of one worker; attempts, where its work may have killed it."""
        with self._store.writing() as connection:
            return leases.worker_died(
                connection, worker_id, now_s=self._now_s(), policy=self._policy
            )

    def retry(self, log_ids: Sequence[str] | None = None) -> list[ParkedWork]:
        """Open parked work again, with all of its attempts; what is done stays done.

        Args:
            log_ids: Only that of these logs; None: all that `status` names as parked.

        Returns:
            What was parked until now; once more, and nothing is.

        Raises:
            NothingFoundError: If one of these logs is not in the bucket; then nothing is changed.
        """
        with self._store.writing() as connection:
            return retrying.retry(connection, log_ids)

    # Scenes and outbox.

    def unpublished(self, limit: int) -> list[StoredScene]:
        """Events after the cursor in the order of their numbers, withdrawals among them."""
        with self._store.reading() as connection:
            return scenes.unpublished(connection, limit=limit, on_damaged=self._store.note_damaged)

    def mark_published(self, seq: int) -> None:
        """Move the cursor forward, durably: everything up to `seq` is published."""
        with self._store.writing() as connection:
            events.mark_published(connection, seq)

    def last_seq(self) -> int:
        """Number of the newest event, 0 when there is none."""
        with self._store.reading() as connection:
            return events.counter(connection, "seq")

    def scenes_since(self, seq: int, limit: int | None = None) -> list[StoredScene]:
        """Current scenes with a greater number, in the order of their numbers."""
        with self._store.reading() as connection:
            return scenes.current_scenes(
                connection, after=seq, limit=limit, on_damaged=self._store.note_damaged
            )

    def events_since(self, seq: int, limit: int) -> list[StoredScene]:
        """Current scenes and withdrawals with a greater number, in the order of their numbers."""
        with self._store.reading() as connection:
            return scenes.events_since(
                connection, after=seq, limit=limit, on_damaged=self._store.note_damaged
            )

    def newest_scenes(self, limit: int) -> list[StoredScene]:
        """The current scenes with the highest numbers, in the order of their numbers."""
        with self._store.reading() as connection:
            return scenes.current_scenes(
                connection, limit=limit, newest=True, on_damaged=self._store.note_damaged
            )

    def current_scenes(self) -> list[StoredScene]:
        """Every current scene, in the order of their numbers."""
        with self._store.reading() as connection:
            return scenes.current_scenes(connection, on_damaged=self._store.note_damaged)

    def scene(self, scene_id: str) -> StoredScene | None:
        """The current scene of this id.

        Raises:
            RecordDamagedError: If its record is damaged.
        """
        with self._store.reading() as connection:
            return scenes.current_scene(connection, scene_id, on_damaged=self._store.note_damaged)

    def ranking(self, *, most: int | None = None) -> list[RankedScene]:
        """Rank current scenes, best first, and list so many; None: all."""
        with self._store.reading() as connection:
            return list(ranking.ranked(connection, most=most, on_damaged=self._store.note_damaged))

    def select(self, *, budget: int, strategy: str = DEFAULT) -> list[RankedScene]:
        """Choose scenes of the ranking, or raise as `service.curation.strategies` does."""
        with (
            self._store.reading() as connection,
            closing(ranking.ranked(connection, on_damaged=self._store.note_damaged)) as ranked,
        ):
            return select(ranked, budget=budget, strategy=strategy)

    def rate_sums(self, request: RatesRequest) -> list[RateSums]:
        """Sums over the groups of current scenes that this asks for, in no order."""
        with self._store.reading() as connection:
            return rates.rate_sums(connection, request)

    # Selections.

    def save_selection(
        self, name: str | None, *, budget: int, scenes: Sequence[RankedScene]
    ) -> Selection:
        """Store a named selection; without a name it becomes `selection-<n>`.

        A selection never changes: labellers work from it. The same one again is no error.

        Raises:
            SelectionExistsError: If a different selection has this name.
        """
        with self._store.writing() as connection:
            return selections.save_selection(
                connection, name, budget=budget, scenes=scenes, now_s=self._now_s()
            )

    def selection(self, name: str) -> Selection | None:
        """The selection of this name."""
        with self._store.reading() as connection:
            return selections.selection(connection, name)

    def selections(self) -> list[Selection]:
        """Every selection, oldest first."""
        with self._store.reading() as connection:
            return selections.selections(connection)

    # How far it is.

    def backlog(self) -> Backlog:
        """What waits, runs and is stuck, under the newest pipeline version."""
        with self._store.reading() as connection:
            return backlog.backlog(connection, now_s=self._now_s())

    def status(self, pipeline_version: str | None = None) -> Status:
        """How far everything is under this pipeline version; by default the newest."""
        with self._store.reading() as connection:
            return overview.status(connection, pipeline_version, now_s=self._now_s())

    def settled(self, pipeline_version: str) -> bool:
        """Whether nothing is left to do under this pipeline version.

        True when every current recording is planned, refused or parked, and every shard done or
        parked.
        """
        with self._store.reading() as connection:
            return overview.settled(connection, pipeline_version)
