"""Notices of changed objects: their forms, and what the watch makes of them."""

import json
from collections.abc import Iterator
from contextlib import suppress
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.runtime.http_endpoint import HttpEndpoint, HttpRequest
from schemas.transport.bucket import Bucket, ObjectMeta, open_bucket
from schemas.transport.recordings import group_recordings
from service.background.bucket_notices import MAX_WAITING, PATH, BucketNotices, keys_of
from service.background.bucket_watch import BucketWatch
from service.background.changed_objects import with_objects
from service.errors import UsageError
from service.store.engine import open_store
from service.store.recordings import SyncResult
from tests.contracts.ledger_world import World


def record(key: str, bucket: str = "logs", event: str = "ObjectCreated:Put") -> dict[str, Any]:
    """A record as Ceph sends it; AWS and MinIO add fields that nothing reads."""
    return {
        "eventVersion": "2.2",
        "eventSource": "ceph:s3",
        "eventTime": "2026-11-25T03:00:00.000Z",
        "eventName": event,
        "s3": {
            "s3SchemaVersion": "1.0",
            "configurationId": "counterpoint",
            "bucket": {"name": bucket, "arn": f"arn:aws:s3:default::{bucket}", "id": "x"},
            "object": {"key": key, "size": 3, "eTag": "abc", "versionId": ""},
        },
    }


def body(*records: dict[str, Any]) -> bytes:
    return json.dumps({"Records": records}).encode()


def test_keys_are_those_of_this_bucket_and_folder() -> None:
    notice = body(record("fleet/a.mcap"), record("other/b.mcap"), record("fleet/c.mcap", "else"))
    assert list(keys_of(notice, bucket="logs", prefix="fleet")) == ["a.mcap"]
    assert list(keys_of(notice, bucket="", prefix="")) == [
        "fleet/a.mcap",
        "other/b.mcap",
        "fleet/c.mcap",
    ]


def test_an_encoded_key_is_read_in_both_forms() -> None:
    notice = body(record("car+7/50%25.mcap"))
    assert list(keys_of(notice, bucket="logs", prefix="")) == ["car 7/50%.mcap", "car+7/50%25.mcap"]


def test_an_envelope_of_sns_is_opened() -> None:
    notice = json.dumps({"Type": "Notification", "Message": body(record("a.mcap")).decode()})
    assert list(keys_of(notice.encode(), bucket="logs", prefix="")) == ["a.mcap"]
    confirmation = {"Type": "SubscriptionConfirmation", "SubscribeURL": "https://sns/confirm"}
    assert list(keys_of(json.dumps(confirmation).encode(), bucket="logs", prefix="")) == []
    test = {"Service": "Amazon S3", "Event": "s3:TestEvent"}
    assert list(keys_of(json.dumps(test).encode(), bucket="logs", prefix="")) == []


@given(
    st.one_of(
        st.binary(max_size=200),
        st.recursive(
            st.none() | st.text(max_size=5) | st.integers(),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(
                    st.sampled_from(["Records", "s3", "object", "key", "Type"]), inner
                )
            ),
            max_leaves=8,
        ).map(lambda found: json.dumps(found).encode()),
    )
)
def test_whatever_is_posted_is_keys_or_a_sentence(posted: bytes) -> None:
    keys: list[str] = []
    with suppress(UsageError):
        keys += keys_of(posted, bucket="logs", prefix="")
    assert all(isinstance(key, str) for key in keys)


def test_too_many_keys_ask_for_a_listing() -> None:
    notices = BucketNotices("s3://logs")
    for begin in range(0, MAX_WAITING + 1, 1000):
        records = [record(f"{number}.mcap") for number in range(begin, begin + 1000)]
        notices.answer(HttpRequest(body=body(*records)))
    assert notices.drain() is None
    assert notices.drain() == []
    notices.give_back(["a.mcap"])
    assert notices.drain() == ["a.mcap"]


NAMES = st.sampled_from([f"d{n}" for n in ("", "_0", "_1", "_2", "_0_0", "_0_1", "x")])


@given(
    st.sets(NAMES), st.dictionaries(NAMES, st.sampled_from(["new", "gone"]), min_size=1, max_size=3)
)
def test_single_objects_give_the_recordings_of_a_whole_listing(
    there: set[str], changes: dict[str, str]
) -> None:
    before = [ObjectMeta(f"{name}.mcap", 1, "old") for name in sorted(there | {"z"})]
    before.sort(key=lambda each: each.key)
    found = {
        f"{name}.mcap": ObjectMeta(f"{name}.mcap", 1, "new") if what == "new" else None
        for name, what in changes.items()
    }
    change = with_objects(before, found)
    assert list(change.objects) == sorted(change.objects, key=lambda each: each.key)
    was = {each.log_id: each for each in group_recordings(before)}
    now = {each.log_id: each for each in group_recordings(change.objects)}
    kept = {log_id: each for log_id, each in was.items() if log_id not in change.log_ids}
    assert kept | {each.log_id: each for each in change.recordings} == now


class CountedBucket(Bucket):
    """A real folder whose requests are counted."""

    lists = heads = 0

    def list(self, *arguments: Any, **options: Any) -> Iterator[ObjectMeta]:
        self.lists += 1
        return super().list(*arguments, **options)

    def head(self, key: str) -> ObjectMeta | None:
        self.heads += 1
        return super().head(key)


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    (tmp_path / "state").mkdir()
    store = open_store(tmp_path / "state")
    yield World.on(store)
    store.close()


def test_only_named_objects_are_looked_up(world: World, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    bucket = open_bucket(folder.as_uri())
    bucket.__class__ = CountedBucket
    assert isinstance(bucket, CountedBucket)
    for name in ("a", "b_0", "b_1"):
        (folder / f"{name}.mcap").write_bytes(name.encode())
    watch = BucketWatch(bucket, world.ledger, exclude=("test/*",))
    assert watch.look_at(["a.mcap"]) == SyncResult()
    assert watch.list_once() == SyncResult(new=("a", "b"))
    (folder / "c.mcap").write_bytes(b"c")
    (folder / "b_2.mcap").write_bytes(b"more")
    (folder / "a.mcap").unlink()
    (folder / "unnamed.mcap").write_bytes(b"d")
    names = ["c.mcap", "b_2.mcap", "a.mcap", "test/x.mcap", "notes.txt", "none.mcap"]
    assert watch.look_at(names) == SyncResult(new=("c",), replaced=("b",), deleted=("a",))
    assert (bucket.lists, bucket.heads) == (1, 4)
    assert watch.look_at(names) == SyncResult()
    assert watch.list_once() == SyncResult(new=("unnamed",))


def test_a_bucket_that_a_notice_empties_is_doubted(world: World, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "a.mcap").write_bytes(b"a")
    watch = BucketWatch(open_bucket(folder.as_uri()), world.ledger, settle_s=60.0)
    watch.list_once()
    (folder / "a.mcap").unlink()
    assert watch.look_at(["a.mcap"]) == SyncResult()
    assert world.ledger.has_recordings()


def test_notices_come_by_post_with_a_body_alone() -> None:
    notices = BucketNotices("s3://logs")
    with HttpEndpoint("127.0.0.1:0", {}, posts={PATH: notices.answer}) as http:

        def posted(content: bytes, method: str = "POST") -> int:
            connection = HTTPConnection("127.0.0.1", http.port, timeout=5)
            connection.request(method, PATH, content)
            return connection.getresponse().status

        assert posted(body(record("a.mcap"))) == 200
        assert notices.drain() == ["a.mcap"]
        assert posted(b"[]") == 400
        assert posted(b"x" * ((1 << 20) + 1)) == 413
        assert posted(b"", "GET") == 405
        assert notices.drain() == []
