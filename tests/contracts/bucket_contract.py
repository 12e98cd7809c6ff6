"""What any bucket must do, whatever store lies behind it; run on memory, on files and on S3."""

from abc import abstractmethod
from threading import Thread

import pytest

from schemas.errors import BucketRefusedError, ObjectChangedError
from schemas.transport.bucket import Bucket


class BucketContract:
    """Subclass it as `Test…` and give it a bucket."""

    @abstractmethod
    def make_bucket(self) -> Bucket:
        """Return an empty bucket that may be written."""

    @pytest.fixture
    def bucket(self) -> Bucket:
        return self.make_bucket()

    def test_objects_are_listed_by_key_with_size_and_etag(self, bucket: Bucket) -> None:
        for key in ("b/2.mcap", "a/10.mcap", "b/1.mcap"):
            bucket.put(key, key.encode() * 2)
        listed = list(bucket.list())
        assert [found.key for found in listed] == ["a/10.mcap", "b/1.mcap", "b/2.mcap"]
        assert [found.size for found in listed] == [18, 16, 16]
        assert all(found.etag for found in listed)

    def test_a_prefix_is_a_folder(self, bucket: Bucket) -> None:
        for key in ("fleet/1", "fleet/2", "fleet-b/1", "other"):
            bucket.put(key, b"x")
        assert [found.key for found in bucket.list("fleet")] == ["fleet/1", "fleet/2"]
        assert [found.key for found in bucket.list("fleet/")] == ["fleet/1", "fleet/2"]
        assert list(bucket.list("nowhere")) == []

    def test_a_listing_can_begin_after_a_key(self, bucket: Bucket) -> None:
        for number in range(5):
            bucket.put(f"{number}", b"x")
        assert [found.key for found in bucket.list(start_after="2")] == ["3", "4"]

    def test_a_listing_of_a_folder_can_begin_after_a_key(self, bucket: Bucket) -> None:
        for key in ("a/9", "fleet/1", "fleet/2", "fleet/3", "z/1"):
            bucket.put(key, b"x")
        after = bucket.list("fleet", start_after="fleet/1")
        assert [found.key for found in after] == ["fleet/2", "fleet/3"]
        first = next(bucket.list(start_after="fleet/15"))  # which is no key
        assert first.key == "fleet/2"

    def test_keys_are_in_the_order_of_their_bytes(self, bucket: Bucket) -> None:
        keys = ["B", "a", "a-b/1", "a.b", "a/1", "a/1.mcap", "a/10", "a0", "z", "ß", "中", "🚗"]
        for key in reversed(keys):
            bucket.put(key + "/log" if key in ("a", "z") else key, b"x")
        listed = [found.key for found in bucket.list()]
        assert listed == sorted(listed, key=str.encode)
        assert len(listed) == len(keys)

    def test_an_empty_object_is_listed_and_read_whole(self, bucket: Bucket) -> None:
        bucket.put("empty.mcap", b"")
        (found,) = bucket.list()
        assert found.size == 0
        assert bucket.read_all("empty.mcap") == b""
        with pytest.raises(ObjectChangedError):
            bucket.read_range("empty.mcap", 0, 1, found.etag)

    @pytest.mark.parametrize("key", ["a b.mcap", "ü.mcap", "a%20b.mcap", "x#[1]~.mcap"])
    def test_odd_keys_come_back_as_they_are(self, bucket: Bucket, key: str) -> None:
        bucket.put(key, b"data")
        (found,) = bucket.list()
        assert found.key == key
        assert bucket.read_range(found.key, 0, 4, found.etag) == b"data"

    def test_a_range_is_exactly_these_bytes(self, bucket: Bucket) -> None:
        bucket.put("log", bytes(range(100)))
        (found,) = bucket.list()
        assert bucket.read_range("log", 10, 5, found.etag) == bytes(range(10, 15))
        assert bucket.read_range("log", 99, 1, found.etag) == b"c"

    def test_reads_are_counted(self, bucket: Bucket) -> None:
        bucket.put("log", bytes(100))
        (found,) = bucket.list()
        bucket.read_range("log", 0, 60, found.etag)
        bucket.read_all("log")
        assert (bucket.reads, bucket.bytes_read) == (2, 160)

    @pytest.mark.parametrize("length", [5, 101])
    def test_a_replaced_object_is_not_read(self, bucket: Bucket, length: int) -> None:
        bucket.put("log", bytes(100))
        (found,) = bucket.list()
        bucket.put("log", bytes(length))
        with pytest.raises(ObjectChangedError, match="log") as caught:
            bucket.read_range("log", 0, 5, found.etag)
        assert caught.value.key == "log"

    @pytest.mark.parametrize("offset", [98, 200])
    def test_a_range_beyond_the_end_is_an_error(self, bucket: Bucket, offset: int) -> None:
        bucket.put("log", bytes(100))
        (found,) = bucket.list()
        with pytest.raises(ObjectChangedError):
            bucket.read_range("log", offset, 5, found.etag)

    def test_a_missing_object_has_no_head_and_cannot_be_read(self, bucket: Bucket) -> None:
        assert bucket.head("log") is None
        with pytest.raises(ObjectChangedError):
            bucket.read_all("log")
        with pytest.raises(ObjectChangedError):
            bucket.read_range("log", 0, 1, "")

    def test_the_head_is_what_the_listing_says(self, bucket: Bucket) -> None:
        bucket.put("a/log", b"123")
        (found,) = bucket.list()
        assert bucket.head("a/log") == found

    def test_an_object_may_be_replaced(self, bucket: Bucket) -> None:
        bucket.put("a", b"old")
        bucket.put("a", b"new")
        assert bucket.read_all("a") == b"new"

    def test_a_deleted_object_is_gone_and_deleting_it_again_is_no_error(
        self, bucket: Bucket
    ) -> None:
        for key in ("a/b/1.overlay", "a/b/2.overlay", "c/@/ä 1%2E.overlay"):
            bucket.put(key, b"x")
        for _ in range(2):
            bucket.delete("a/b/1.overlay")
            bucket.delete("c/@/ä 1%2E.overlay")
        assert [found.key for found in bucket.list()] == ["a/b/2.overlay"]
        bucket.delete("a/b/2.overlay")
        assert list(bucket.list()) == []
        bucket.put("a/b/1.overlay", b"again")
        assert bucket.read_all("a/b/1.overlay") == b"again"

    def test_a_key_that_no_store_can_hold_is_refused(self, bucket: Bucket) -> None:
        with pytest.raises(BucketRefusedError):
            bucket.put("a//../b", b"x")

    def test_several_threads_may_read_at_once(self, bucket: Bucket) -> None:
        bucket.put("log", bytes(1000))
        (found,) = bucket.list()

        def read() -> None:
            for _ in range(50):
                bucket.read_range("log", 3, 7, found.etag)

        threads = [Thread(target=read) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert (bucket.reads, bucket.bytes_read) == (200, 1400)
