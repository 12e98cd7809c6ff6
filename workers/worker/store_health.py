"""Store health: separates trouble of a store as a whole, which is waited out, from one object's.

An outage or expired credentials would fail every shard, one after the other. A store in trouble
therefore costs no attempt, and a worker claims nothing until it works again.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from itertools import chain, islice
from threading import Event
from typing import Final

import structlog

from schemas.errors import (
    BucketRefusedError,
    BucketUnreachableError,
    CounterpointError,
    ObjectChangedError,
    PermanentError,
    TransientError,
)
from schemas.runtime.retry import backoff_s, pause
from schemas.transport.bucket import Bucket, ObjectMeta
from schemas.work import Recording
from workers.ingest.prediction_files import open_predictions
from workers.worker.metrics import Store, StoreError, WorkerMetrics

log = structlog.get_logger(__name__)

PROBE_KEY: Final = "counterpoint-probe"
"""Object of the artifacts that is written, and deleted again, to test write access."""

PROBED_OBJECTS: Final = 3
"""Other logs of which one must be readable where a log is not, so that the log is at fault."""

FIRST_WAIT_S: Final = 1.0
MOST_WAIT_S: Final = 30.0


class StoreTroubleError(TransientError):
    """A store as a whole is unreachable or refuses, independently of the lease."""

    def __init__(
        self, error: CounterpointError, *, store: Store, again: Callable[[], None]
    ) -> None:
        """Keep a probe for the end of the trouble.

        Args:
            error: The error of the store.
            store: Which one.
            again: Raises a store's error for as long as the trouble lasts.
        """
        super().__init__(str(error))
        self.store: Store = store
        self.kind: StoreError = kind_of(error)
        self.again = again


def kind_of(error: CounterpointError) -> StoreError:
    """Classify a store's error as unreachable or refused."""
    return "refused" if isinstance(error, BucketRefusedError) else "unreachable"


def cause_of(
    error: CounterpointError,
    bucket: Bucket,
    recording: Recording,
    *,
    repeated: bool,
    predictions: str = "",
) -> CounterpointError:
    """Find the cause of an error while reading a log, or the predictions next to it.

    Args:
        error: The error of the bucket.
        bucket: The log bucket.
        recording: The recording that was read.
        repeated: The same work ended with this error before: a stretch of an object that can never
            be read is the object's fault, though its beginning can be read.
        predictions: The setting.

    Returns:
        A `StoreTroubleError` if a store as a whole is in trouble, or was and no longer is; an
        `ObjectChangedError` if the log was replaced; else the error itself.
    """
    trouble = StoreTroubleError(error, store="bucket", again=lambda: _list(bucket))
    if not _works(trouble.again):
        return trouble
    beside = StoreTroubleError(
        error, store="predictions", again=lambda: _list(open_predictions(predictions))
    )
    if predictions and not _works(beside.again):
        return beside
    try:
        # objects may be refused one by one, or be on a part of the store that is gone
        own = _works(lambda: _read_first_bytes(bucket, recording))
    except ObjectChangedError as changed:
        return changed
    if own:
        return error if repeated and trouble.kind == "unreachable" else trouble
    if not _works(trouble.again):
        return trouble
    if others := _other_objects(bucket, recording):  # listing may be allowed, and reading not
        unread = StoreTroubleError(error, store="bucket", again=lambda: _read_any(bucket, others))
        if not _works(unread.again):
            return unread
    return error


def put_artifact(artifacts: Bucket, key: str, data: bytes) -> None:
    """Write an artifact.

    Raises:
        StoreTroubleError: If nothing of this size can be written there now.
        TransientError: If only this object cannot be written now.
        PermanentError: If only this object is refused.
    """

    def probe() -> None:
        try:
            artifacts.put(PROBE_KEY, data)
        finally:
            _delete_probe(artifacts)

    try:
        artifacts.put(key, data)
        return
    except (BucketUnreachableError, BucketRefusedError) as error:
        if not _works(probe):
            raise StoreTroubleError(error, store="artifacts", again=probe) from None
    try:
        artifacts.put(key, data)  # an outage may have passed meanwhile
    except BucketUnreachableError as error:
        raise TransientError(str(error)) from None
    except BucketRefusedError as error:
        raise PermanentError(str(error)) from None


@contextmanager
def reading_artifacts(artifacts: Bucket) -> Iterator[None]:
    """Turn artifacts that do not answer into a trouble of the store.

    Raises:
        StoreTroubleError: If they cannot be read now.
    """
    try:
        yield
    except BucketUnreachableError as error:
        raise StoreTroubleError(error, store="artifacts", again=lambda: _list(artifacts)) from None


def _delete_probe(artifacts: Bucket) -> None:
    """Delete the probe; where only writing is allowed, it stays and is empty."""
    try:
        artifacts.delete(PROBE_KEY)
    except CounterpointError:
        with suppress(CounterpointError):  # the probe itself has reported the error
            artifacts.put(PROBE_KEY, b"")


def wait_until_over(
    trouble: StoreTroubleError,
    *,
    stop: Event,
    metrics: WorkerMetrics,
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Wait until a store works again; log once at the beginning and once at the end.

    Raises:
        StoppedError: If stopped meanwhile.
    """
    log.warning("waiting for a store", store=trouble.store, problem=str(trouble))
    metrics.waiting_for(trouble.store, True)
    began_s = clock()
    try:
        for wait_s in backoff_s(first_s=FIRST_WAIT_S, most_s=MOST_WAIT_S):
            pause(stop, wait_s)
            if _works(trouble.again):
                break
    finally:
        metrics.waiting_for(trouble.store, False)
    log.info("store works again", store=trouble.store, waited_s=round(clock() - began_s, 1))


def _works(attempt: Callable[[], None]) -> bool:
    try:
        attempt()
    except (BucketUnreachableError, BucketRefusedError) as error:
        log.debug("store does not work", problem=str(error))
        return False
    return True


def _list(bucket: Bucket) -> None:
    next(bucket.list(), None)


def _other_objects(bucket: Bucket, recording: Recording) -> list[ObjectMeta]:
    """Return some objects that are no part of a recording, those after it first."""
    own = {part.key for part in recording.parts}
    after = bucket.list(start_after=recording.parts[-1].key)
    others = (each for each in chain(after, bucket.list()) if each.size and each.key not in own)
    found: list[ObjectMeta] = []
    with suppress(BucketUnreachableError, BucketRefusedError):  # then the error stays the log's own
        found.extend(islice(others, PROBED_OBJECTS))
    return found


def _read_any(bucket: Bucket, objects: Sequence[ObjectMeta]) -> None:
    """Read the first byte of one of these objects.

    Raises:
        BucketUnreachableError: If the store does not answer for the last one, nor for the others.
        BucketRefusedError: If it refuses the last one, and no other can be read.
    """
    for each in objects[:-1]:
        if _works(partial(_read_first_byte, bucket, each)):
            return
    _read_first_byte(bucket, objects[-1])


def _read_first_byte(bucket: Bucket, found: ObjectMeta) -> None:
    with suppress(ObjectChangedError):  # it answers
        bucket.read_range(found.key, 0, 1, found.etag)


def _read_first_bytes(bucket: Bucket, recording: Recording) -> None:
    for part in recording.parts:
        if part.size:
            bucket.read_range(part.key, 0, 1, part.etag)
