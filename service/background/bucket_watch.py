"""The log bucket, listed and taken over; the service opens no object of it."""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Final

import structlog

from schemas.bounds import MAX_LOG_ID
from schemas.errors import BucketRefusedError, BucketUnreachableError
from schemas.transport.bucket import Bucket, ObjectMeta
from schemas.transport.folder import Skipped
from schemas.transport.recordings import group_recordings, is_too_long
from service.store.ledger import Ledger
from service.store.recordings import SyncResult

log = structlog.get_logger(__name__)

RESUME_WITHIN_S: Final = 600.0
"""A listing that broke off longer ago begins anew: its first keys tell of another day."""

MAX_SKIPPED_NAMED: Final = 100
"""Entries that are logged by name; beyond them only their number is."""


@dataclass(frozen=True, slots=True)
class BucketSeen:
    """What the listings have shown so far.

    Attributes:
        last_success_s: When the last whole listing was taken over, by the ledger's clock.
        duration_s: What that listing took, without waits after errors.
        recordings: Recordings it held.
        objects: Objects they consist of.
        bytes: Their sizes together.
        errors: Listings that broke off, by `unreachable` and `refused`.
        problem: Why the last one broke off; empty after a whole one.
        skipped: Entries of the last whole listing that can be no log, as a rule by their names.
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
    """Tells the ledger what lies in the bucket.

    Attributes:
        seen: What the listings have shown so far; replaced whole, so any thread may read it.
        listed_at_s: When the last whole listing ended, monotonic seconds; None before the first.
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
        """Take the bucket, and what of it counts.

        Args:
            bucket: The log bucket, which is only listed.
            ledger: Takes the listings over.
            include: Patterns as of a shell, for whole keys, `*` also for `/`; only keys that match
                one count. Empty: all.
            exclude: Keys that match one of these do not count.
            settle_s: A bucket that is suddenly empty is believed when it stays so for this long.
            elapsed_s: A clock that never steps, for durations.
        """
        self._bucket, self._ledger = bucket, ledger
        self._include, self._exclude, self._settle_s = include, exclude, settle_s
        self._elapsed_s = elapsed_s
        self._listed: list[ObjectMeta] = []
        """What a listing that broke off had listed: the next one goes on after it."""
        self._skipped: dict[str, Skipped] = {}
        """What this listing has left out so far, by name."""
        self._named: set[str] = set()
        """What the listing before left out, and was logged then."""
        self._taken_over: list[ObjectMeta] | None = None
        """What the ledger took over last: the same again is no news to it."""
        self._is_ours = False
        self._took_s, self._broke_off_s = 0.0, 0.0
        self._empty_since_s: float | None = None
        self._errors: Counter[str] = Counter(unreachable=0, refused=0)
        self.seen = BucketSeen()
        self.listed_at_s: float | None = None

    @property
    def recordings(self) -> int | None:
        """How many recordings the last listing held; None before the first."""
        return None if self.seen.last_success_s is None else self.seen.recordings

    def list_once(self) -> SyncResult:
        """List the bucket, or the rest of it after a listing that broke off, and take it over.

        Raises:
            BucketUnreachableError: If the store does not answer, or a local folder is gone.
            BucketRefusedError: If it says no.
            OtherBucketError: If the ledger is that of another bucket.
        """
        objects = self._with_hidden(self._objects())
        if objects == self._taken_over and not self._ledger.stale_logs():
            result = SyncResult()  # nothing has changed, as most of the time
        else:
            result = self._take_over(objects)
        now_s, took_s = self._ledger.now_s(), self._took_s
        self._name_skipped()
        self.seen = replace(
            self.seen,
            last_success_s=now_s,
            duration_s=took_s,
            problem="",
            skipped=len(self._skipped),
        )
        self.listed_at_s, self._took_s = self._elapsed_s(), 0.0
        return result

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
            log.info("bucket holds logs again", bucket=self._bucket.url, recordings=len(found))
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
        """List to the end, or break off keeping what has come so far."""
        began_s = self._elapsed_s()
        if self._listed and began_s - self._broke_off_s > RESUME_WITHIN_S:
            self._listed, self._took_s = [], 0.0
        listed = self._listed
        if listed:
            log.info("listing goes on", after=listed[-1].key, objects=len(listed))
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
        """Log each entry that is left out, once as long as it stays there."""
        new = [each for name, each in self._skipped.items() if name not in self._named]
        for each in new[:MAX_SKIPPED_NAMED]:
            log.warning("entry of the bucket is left out", entry=each.name, problem=each.why)
        if new[MAX_SKIPPED_NAMED:]:
            log.warning("more entries are left out", entries=len(new) - MAX_SKIPPED_NAMED)
        self._named = set(self._skipped)

    def _with_hidden(self, listed: list[ObjectMeta]) -> list[ObjectMeta]:
        """Keep what the last listing showed in folders that may not be read any more.

        Raises:
            BucketRefusedError: If logs of such a folder are recorded, and no listing since the
                start has shown them: they would count as deleted.
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
                    f"or say exclude = {folder}* to have them count as deleted ({self._bucket.url})"
                )
                self._errors["refused"] += 1
                self.seen = replace(self.seen, errors=dict(self._errors), problem=problem)
                raise BucketRefusedError(problem)
        return listed

    def _is_empty_for_good(self) -> bool:
        """Whether to believe that all logs are gone: a disk that is not mounted looks like that."""
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


def is_wanted(key: str, *, include: Sequence[str], exclude: Sequence[str]) -> bool:
    """Whether an object counts: it matches a pattern to include, if any, and none to exclude."""
    included = not include or any(fnmatchcase(key, each) for each in include)
    return included and not any(fnmatchcase(key, each) for each in exclude)
