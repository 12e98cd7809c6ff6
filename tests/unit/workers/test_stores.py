"""Whose fault an error of a store is: an outage costs no attempt, a bad object costs its log."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from obstore.store import MemoryStore
from structlog.testing import capture_logs

from schemas.errors import (
    BucketRefusedError,
    BucketUnreachableError,
    CounterpointError,
    ObjectChangedError,
    PermanentError,
    TransientError,
)
from schemas.runtime.retry import StoppedError
from schemas.transport.bucket import Bucket, ObjectMeta, open_bucket
from schemas.transport.folder import Skipped
from schemas.work import Part, Recording
from workers.worker.metrics import WorkerMetrics
from workers.worker.store_health import (
    PROBE_KEY,
    StoreTroubleError,
    cause_of,
    put_artifact,
    wait_until_over,
)

Fault = Callable[[str, int], CounterpointError | None]
"""Key (empty: a listing) and bytes to an error of the store, or none."""

REFUSED = BucketRefusedError("the store refuses these credentials")
AWAY = BucketUnreachableError("the store cannot be reached: connection refused")


class FaultyBucket(Bucket):
    """A bucket in memory that fails as told."""

    def __init__(self, fault: Fault = lambda key, size: None) -> None:
        super().__init__(MemoryStore(), url="memory://")
        super().put("a.mcap", b"0123456789")
        self.fault = fault

    def list(
        self,
        prefix: str = "",
        start_after: str | None = None,
        *,
        on_skipped: Callable[[Skipped], None] = lambda skipped: None,
    ) -> Iterator[ObjectMeta]:
        self._fail("", 0)
        return super().list(prefix, start_after, on_skipped=on_skipped)

    def read_range(self, key: str, offset: int, length: int, etag: str) -> bytes:
        self._fail(key, length)
        return super().read_range(key, offset, length, etag)

    def put(self, key: str, data: bytes) -> None:
        self._fail(key, len(data))
        super().put(key, data)

    def _fail(self, key: str, size: int) -> None:
        error = self.fault(key, size)
        if error is not None:
            raise error


def recording_in(bucket: Bucket, *, etag: str | None = None) -> Recording:
    meta = bucket.head("a.mcap")
    assert meta is not None
    part = Part(key="a.mcap", size=meta.size, etag=meta.etag if etag is None else etag)
    return Recording(log_id="a", parts=(part,))


def judged(
    error: CounterpointError, fault: Fault, *, repeated: bool = False
) -> tuple[CounterpointError, CounterpointError]:
    bucket = FaultyBucket(fault)
    return error, cause_of(error, bucket, recording_in(bucket), repeated=repeated)


@pytest.mark.parametrize("error", [REFUSED, AWAY])
def test_a_store_that_fails_as_a_whole_is_no_fault_of_the_log(error: CounterpointError) -> None:
    _, cause = judged(error, lambda key, size: error)
    assert isinstance(cause, StoreTroubleError)
    assert cause.kind == ("refused" if error is REFUSED else "unreachable")
    assert str(cause) == str(error)


@pytest.mark.parametrize("error", [REFUSED, AWAY])
def test_an_object_that_fails_alone_is_its_logs_own_problem(error: CounterpointError) -> None:
    _, cause = judged(error, lambda key, size: error if key else None)
    assert cause is error


@pytest.mark.parametrize("error", [REFUSED, AWAY])
def test_a_store_that_lists_and_lets_nothing_be_read_is_waited_for(
    error: CounterpointError,
) -> None:
    bucket = FaultyBucket(lambda key, size: error if key in closed else None)
    closed: set[str] = set()
    bucket.put("b.mcap", b"0123456789")
    bucket.put("empty.mcap", b"")
    recording = recording_in(bucket)
    closed |= {"a.mcap", "b.mcap"}
    cause = cause_of(error, bucket, recording, repeated=True)
    assert isinstance(cause, StoreTroubleError)
    with pytest.raises(type(error)):
        cause.again()
    closed.remove("b.mcap")
    cause.again()
    assert cause_of(error, bucket, recording, repeated=True) is error


@pytest.mark.parametrize("error", [REFUSED, AWAY])
def test_an_outage_that_is_over_by_now_costs_nothing(error: CounterpointError) -> None:
    _, cause = judged(error, lambda key, size: None)
    assert isinstance(cause, StoreTroubleError)


def test_a_stretch_that_never_comes_is_in_the_end_the_objects_fault() -> None:
    _, cause = judged(AWAY, lambda key, size: None, repeated=True)
    assert cause is AWAY


def test_credentials_that_come_and_go_never_park_anything() -> None:
    _, cause = judged(REFUSED, lambda key, size: None, repeated=True)
    assert isinstance(cause, StoreTroubleError)


def test_a_disk_that_is_not_mounted_is_waited_for_and_no_log_is_to_blame(tmp_path: Path) -> None:
    disk, elsewhere = tmp_path / "disk", tmp_path / "elsewhere"
    disk.mkdir()
    (disk / "a.mcap").write_bytes(b"x")
    bucket = open_bucket(str(disk))
    recording = recording_in(bucket)
    disk.rename(elsewhere)
    with pytest.raises(BucketUnreachableError) as caught:
        bucket.read_range("a.mcap", 0, 1, recording.parts[0].etag)
    cause = cause_of(caught.value, bucket, recording, repeated=True)
    assert isinstance(cause, StoreTroubleError)
    with pytest.raises(BucketUnreachableError):
        cause.again()
    elsewhere.rename(disk)
    cause.again()


def test_a_log_that_was_replaced_during_the_outage_is_planned_anew() -> None:
    bucket = FaultyBucket()
    recording = recording_in(bucket, etag='"another"')
    assert isinstance(cause_of(AWAY, bucket, recording, repeated=False), ObjectChangedError)


def test_predictions_that_are_away_are_waited_for_and_the_bucket_is_not_blamed(
    tmp_path: Path,
) -> None:
    bucket, answers = FaultyBucket(), tmp_path / "answers"
    gone = BucketRefusedError(f"predictions: the folder does not exist: {answers}")
    cause = cause_of(*(gone, bucket, recording_in(bucket)), repeated=True, predictions=str(answers))
    assert isinstance(cause, StoreTroubleError)
    assert cause.store == "predictions"
    with pytest.raises(BucketRefusedError, match="predictions: the folder does not exist"):
        cause.again()
    answers.mkdir()
    cause.again()


@pytest.mark.parametrize("error", [REFUSED, AWAY])
def test_artifacts_that_take_nothing_are_a_trouble_to_be_waited_out(
    error: CounterpointError,
) -> None:
    artifacts = FaultyBucket(lambda key, size: error)
    with pytest.raises(StoreTroubleError) as caught:
        put_artifact(artifacts, "overlay", b"points")
    with pytest.raises(type(error)):
        caught.value.again()
    artifacts.fault = lambda key, size: None
    caught.value.again()
    put_artifact(artifacts, "overlay", b"points")
    assert artifacts.read_all("overlay") == b"points"
    assert artifacts.head(PROBE_KEY) is None


def test_a_disk_with_room_for_a_byte_but_not_for_an_overlay_is_a_trouble() -> None:
    full = FaultyBucket(lambda key, size: AWAY if size > 3 else None)
    with pytest.raises(StoreTroubleError):
        put_artifact(full, "overlay", b"points")


@pytest.mark.parametrize(
    ("error", "kind"), [(REFUSED, PermanentError), (AWAY, TransientError)], ids=["refused", "away"]
)
def test_one_overlay_that_alone_cannot_be_written_is_its_shards_own_problem(
    error: CounterpointError, kind: type[CounterpointError]
) -> None:
    artifacts = FaultyBucket(lambda key, size: error if key == "overlay" else None)
    with pytest.raises(kind) as caught:
        put_artifact(artifacts, "overlay", b"points")
    assert not isinstance(caught.value, StoreTroubleError)


def test_an_overlay_that_failed_in_passing_is_written_without_a_word() -> None:
    failed: list[str] = []

    def once(key: str, size: int) -> CounterpointError | None:
        if failed:
            return None
        failed.append(key)
        return AWAY

    artifacts = FaultyBucket(once)
    put_artifact(artifacts, "overlay", b"points")
    assert artifacts.read_all("overlay") == b"points"


def test_waiting_is_said_once_at_its_beginning_and_once_at_its_end() -> None:
    metrics, waiting, failures = WorkerMetrics(), [], 2

    def again() -> None:
        nonlocal failures
        waiting.append(
            metrics.registry.get_sample_value(
                "counterpoint_worker_waiting_for_store", {"store": "bucket"}
            )
        )
        failures -= 1
        if failures > 0:
            raise REFUSED

    trouble = StoreTroubleError(REFUSED, store="bucket", again=again)
    with capture_logs() as said:
        wait_until_over(trouble, stop=threading.Event(), metrics=metrics)
    assert waiting == [1.0, 1.0]
    assert [
        (each["log_level"], each["event"]) for each in said if each["log_level"] != "debug"
    ] == [
        ("warning", "waiting for a store"),
        ("info", "store works again"),
    ]
    now = metrics.registry.get_sample_value(
        "counterpoint_worker_waiting_for_store", {"store": "bucket"}
    )
    assert now == 0.0


def test_whoever_waits_for_a_store_can_be_told_to_stop() -> None:
    stop = threading.Event()
    stop.set()
    trouble = StoreTroubleError(AWAY, store="bucket", again=lambda: None)
    with pytest.raises(StoppedError):
        wait_until_over(trouble, stop=stop, metrics=WorkerMetrics())
