"""Watch of the log bucket: lists its objects into the ledger, and opens none of them."""

import math
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Final

import structlog

from schemas.bounds import MAX_LOG_ID
from schemas.errors import BucketRefusedError, BucketUnreachableError
from schemas.transport.bucket import Bucket, ObjectMeta
from schemas.transport.folder import Skipped
from schemas.transport.recordings import EXTENSION, group_recordings, is_too_long
from service.background.changed_objects import with_objects
from service.background.skipped_entries import is_wanted, skipped_among
from service.curation.status import SkippedEntries
from service.store.ledger import Ledger
from service.store.recordings import SyncResult

log = structlog.get_logger(__name__)

RESUME_WITHIN_S: Final = 600.0
"""Age up to which an interrupted listing is resumed, seconds; its first keys become outdated."""

MAX_AMONG: Final = 5000
"""Logs that are passed to the ledger alone; of more, a database takes all as quickly."""

MAX_SKIPPED_NAMED: Final = 100
"""Skipped entries that are logged by name; further ones are only counted."""


@dataclass(frozen=True, slots=True)
class BucketSeen:
    """Results of the listings so far.

    Attributes:
        last_success_s: Ledger time of the last complete listing, seconds.
        duration_s: Duration of that listing without waits after errors, seconds.
        recordings: Number of recordings in it.
        objects: Number of objects in these recordings.
        bytes: Total size of these objects.
        errors: Interrupted listings, by `unreachable` and `refused`.
        problem: Error that interrupted the last one; empty after a complete one.
        skipped: Entries of the last complete listing that cannot be logs, mostly by their names.
    """

    last_success_s: float | None = None
    duration_s: float = 0.0
    recordings: int = 0
    objects: int = 0
    bytes: int = 0
    errors: Mapping[str, int] = field(default_factory=lambda: {"unreachable": 0, "refused": 0})
    problem: str = ""
    skipped: int = 0


class BucketWatch:
    """Reports the content of the log bucket to the ledger.

    Attributes:
        seen: Results of the listings so far; replaced as a whole, so any thread may read it.
        listed_at_s: End of the last complete listing, monotonic seconds; None before the first.
    """

    def __init__(
        self,
        bucket: Bucket,
        ledger: Ledger,
        *,
        include: Sequence[str] = (),
        exclude: Sequence[str] = (),
        settle_s: float = 0.0,
        elapsed_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Keep the bucket and its filters.

        Args:
            bucket: The log bucket, which is only listed.
            ledger: Receives the listings.
            include: Shell patterns for whole keys, `*` also for `/`; only matching keys count.
                Empty: all.
            exclude: Keys that match one of these do not count.
            settle_s: Time for which a suddenly empty bucket must stay empty before it is believed,
                seconds.
            elapsed_s: Monotonic clock for durations, seconds.
        """
        self._bucket, self._ledger, self._busy = bucket, ledger, Lock()
        self._include, self._exclude, self._settle_s = include, exclude, settle_s
        self._elapsed_s = elapsed_s
        self._listed: list[ObjectMeta] = []
        """Objects of an interrupted listing, which the next one resumes."""
        self._skipped: dict[str, Skipped] = {}
        """Entries that the current listing has skipped so far, by name."""
        self._named: set[str] = set()
        """Names that the listing before skipped, and that were logged then."""
        self._taken_over: list[ObjectMeta] | None = None
        """Listing that the ledger received last; an equal one is not sent again."""
        self._noted: SkippedEntries | None = None
        """Skipped entries that the ledger received last."""
        self._is_ours = False
        self._took_s, self._broke_off_s = 0.0, 0.0
        self._empty_since_s: float | None = None
        self._errors: Counter[str] = Counter(unreachable=0, refused=0)
        self.seen = BucketSeen()
        self.listed_at_s: float | None = None

    @property
    def recordings(self) -> int | None:
        """Number of recordings in the last listing; None before the first."""
        return None if self.seen.last_success_s is None else self.seen.recordings

    def age_s(self) -> float:
        """Return the time since the last complete listing, seconds."""
        listed_at_s = self.listed_at_s
        return math.inf if listed_at_s is None else self._elapsed_s() - listed_at_s

    def list_once(self) -> SyncResult:
        """List the bucket, or resume an interrupted listing, and pass the result to the ledger.

        Raises:
            BucketUnreachableError: If the store does not answer, or a local folder is gone.
            BucketRefusedError: If the store refuses.
            OtherBucketError: If the ledger belongs to another bucket.
        """
        with self._busy:
            return self._list()

    def _list(self) -> SyncResult:
        objects = self._with_hidden(self._objects())
        if objects == self._taken_over and not self._ledger.stale_logs():
            result = SyncResult()  # nothing has changed, as most of the time
        else:
            result = self._take_over(objects)
        now_s, took_s = self._ledger.now_s(), self._took_s
        self._name_skipped()
        self._note_skipped(objects)
        self.listed_at_s, self._took_s = self._elapsed_s(), 0.0
        self.seen = replace(
            self.seen,
            last_success_s=now_s,
            duration_s=took_s,
            problem="",
            skipped=len(self._skipped),
        )
        return result

    def look_at(self, keys: Collection[str]) -> SyncResult:
        """Look up single keys in the bucket, and pass the logs that they belong to to the ledger.

        Keys that a listing leaves out are ignored. Nothing is done before the first listing.

        Raises:
            BucketUnreachableError: If the store does not answer.
            BucketRefusedError: If the store refuses.
        """
        with self._busy:
            if self._taken_over is None:
                return SyncResult()
            wanted = sorted({key for key in keys if self._is_log(key)})
            found = {key: self._bucket.head(key) for key in wanted}
            change = with_objects(self._taken_over, found)
            if change.objects == self._taken_over:
                return SyncResult()
            if not change.objects:
                return self._list()  # which doubts that a bucket is suddenly empty
            if len(change.log_ids) > MAX_AMONG:
                return self._take_over(list(change.objects))
            result = self._ledger.sync_recordings(change.recordings, among=change.log_ids)
            self._taken_over = list(change.objects)
        if result.new or result.replaced or result.deleted:
            log.info(
                "objects looked up",
                keys=len(wanted),
                new=len(result.new),
                replaced=len(result.replaced),
                deleted=len(result.deleted),
            )
        return result

    def _is_log(self, key: str) -> bool:
        return (
            key.endswith(EXTENSION)
            and not is_too_long(key)
            and is_wanted(key, include=self._include, exclude=self._exclude)
        )

    def _take_over(self, objects: list[ObjectMeta]) -> SyncResult:
        found = group_recordings(
            each
            for each in objects
            if is_wanted(each.key, include=self._include, exclude=self._exclude)
        )
        if not self._is_ours:
            self._ledger.serve_bucket(self._bucket.url, found)
            self._is_ours = True
        before = self.recordings
        is_believed = bool(found) or self._is_empty_for_good()
        result = self._ledger.sync_recordings(found) if is_believed else SyncResult()
        self._taken_over = objects if is_believed else None
        if found and self._empty_since_s is not None:
            log.info("bucket contains logs again", bucket=self._bucket.url, recordings=len(found))
            self._empty_since_s = None
        parts = [part for recording in found for part in recording.parts]
        self.seen = replace(
            self.seen,
            recordings=len(found),
            objects=len(parts),
            bytes=sum(part.size for part in parts),
        )
        if not found and before != 0:
            log.warning("no logs in the bucket", bucket=self._bucket.url)
        if result.new or result.replaced or result.deleted:
            log.info(
                "bucket listed",
                recordings=len(found),
                new=len(result.new),
                replaced=len(result.replaced),
                deleted=len(result.deleted),
            )
        return result

    def _objects(self) -> list[ObjectMeta]:
        """List to the end; on an error keep the objects listed so far."""
        began_s = self._elapsed_s()
        if self._listed and began_s - self._broke_off_s > RESUME_WITHIN_S:
            self._listed, self._took_s = [], 0.0
        listed = self._listed
        if listed:
            log.info("listing resumed", after=listed[-1].key, objects=len(listed))
        else:
            self._skipped = {}
        after = listed[-1].key if listed else None
        try:
            for found in self._bucket.list(start_after=after, on_skipped=self._skip):
                if is_too_long(found.key):
                    self._skip(Skipped.of(found.key, f"has a name of over {MAX_LOG_ID} characters"))
                else:
                    listed.append(found)
        except (BucketUnreachableError, BucketRefusedError) as error:
            refused = isinstance(error, BucketRefusedError)
            self._errors["refused" if refused else "unreachable"] += 1
            self.seen = replace(self.seen, errors=dict(self._errors), problem=str(error))
            self._broke_off_s = self._elapsed_s()
            raise
        finally:
            self._took_s += self._elapsed_s() - began_s
        self._listed = []
        return listed

    def _skip(self, skipped: Skipped) -> None:
        name = f"{skipped.name}/" if skipped.hides else skipped.name
        if is_wanted(name, include=(), exclude=self._exclude):
            self._skipped[skipped.name] = skipped

    def _name_skipped(self) -> None:
        """Log each skipped entry, once as long as it exists."""
        new = [each for name, each in self._skipped.items() if name not in self._named]
        for each in new[:MAX_SKIPPED_NAMED]:
            log.warning("entry of the bucket skipped", entry=each.name, problem=each.why)
        if new[MAX_SKIPPED_NAMED:]:
            log.warning("further entries skipped", entries=len(new) - MAX_SKIPPED_NAMED)
        self._named = set(self._skipped)

    def _note_skipped(self, objects: list[ObjectMeta]) -> None:
        """Pass the entries that are no logs to the ledger, if they changed, for `status`."""
        found = skipped_among(
            objects, self._skipped.values(), include=self._include, exclude=self._exclude
        )
        if found != self._noted:
            self._ledger.note_skipped(found)
            self._noted = found

    def _with_hidden(self, listed: list[ObjectMeta]) -> list[ObjectMeta]:
        """Add the objects that the last listing found in folders that can no longer be read.

        Raises:
            BucketRefusedError: If the ledger knows logs of such a folder, and no listing since the
                start has found them; they would count as deleted.
        """
        hidden = [f"{each.hides}/" for each in self._skipped.values() if each.hides]
        if not hidden:
            return listed
        if self._taken_over is not None:
            kept = [each for each in self._taken_over if f"{each.key}/".startswith(tuple(hidden))]
            return sorted([*listed, *kept], key=lambda each: each.key) if kept else listed
        for log_id in (each.log_id for each in self._ledger.status().logs):
            folder = next((each for each in hidden if log_id.startswith(each)), None)
            if folder is not None:
                problem = (
                    f"logs of the folder {folder} are recorded, but it may not be read; permit it, "
                    f"or set exclude = {folder}* to have them count as deleted ({self._bucket.url})"
                )
                self._errors["refused"] += 1
                self.seen = replace(self.seen, errors=dict(self._errors), problem=problem)
                raise BucketRefusedError(problem)
        return listed

    def _is_empty_for_good(self) -> bool:
        """Return true if an empty bucket may be believed; an unmounted disk looks the same."""
        if not self._ledger.has_recordings():
            return True
        now_s = self._elapsed_s()
        if self._empty_since_s is None:
            self._empty_since_s = now_s
            log.warning(
                "bucket is suddenly empty; is its disk mounted? logs are kept for now",
                bucket=self._bucket.url,
                deleted_in_s=self._settle_s,
            )
        if now_s - self._empty_since_s < self._settle_s:
            return False
        log.warning("bucket stays empty: its logs count as deleted", bucket=self._bucket.url)
        return True
