"""The log bucket, listed and taken over; the service opens no object of it."""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Final

import structlog

from schemas.bucket import Bucket, ObjectMeta
from schemas.errors import BucketRefusedError, BucketUnreachableError
from schemas.recordings import group_recordings
from service.ledger import Ledger, SyncResult

log = structlog.get_logger(__name__)

RESUME_WITHIN_S: Final = 600.0
"""A listing that broke off longer ago begins anew: its first keys tell of another day."""


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
    """

    last_success_s: float | None = None
    duration_s: float = 0.0
    recordings: int = 0
    objects: int = 0
    bytes: int = 0
    errors: Mapping[str, int] = field(default_factory=lambda: {"unreachable": 0, "refused": 0})
    problem: str = ""


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
        objects = self._objects()
        if objects == self._taken_over and not self._ledger.stale_logs():
            result = SyncResult()  # nothing has changed, as most of the time
        else:
            result = self._take_over(objects)
        now_s, took_s = self._ledger.now_s(), self._took_s
        self.seen = replace(self.seen, last_success_s=now_s, duration_s=took_s, problem="")
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
        try:
            for found in self._bucket.list(start_after=listed[-1].key if listed else None):
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
