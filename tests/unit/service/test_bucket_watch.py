"""Listings of a bucket that fails, fills, and is suddenly empty."""

from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.parse import parse_qs, urlsplit

import pytest
import structlog.testing
from structlog.typing import EventDict

from schemas.errors import BucketRefusedError, BucketUnreachableError
from schemas.transport.bucket import Bucket, ObjectMeta, open_bucket
from schemas.transport.folder import Skipped
from service.background.bucket_watch import RESUME_WITHIN_S, BucketWatch
from service.curation.status import SkippedEntries, skipped_phrases
from service.errors import OtherBucketError
from service.store.engine import open_store
from tests.contracts.ledger_world import Clock, World


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    folder = tmp_path / "state"
    folder.mkdir()
    store = open_store(folder)
    yield World.on(store)
    store.close()


class PagedStore:
    """An S3 store as far as listing goes, in pages, that refuses when told to."""

    PAGE = 1000

    def __init__(self, keys: list[str]) -> None:
        self.keys = sorted(keys)
        self.pages_left: int | None = None
        """Pages before it refuses; None: it never does."""
        self.asked_after: list[str] = []
        """Where each listing began."""
        store = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                query = {
                    name: value[0] for name, value in parse_qs(urlsplit(self.path).query).items()
                }
                body = store.page(query)
                self.send_response(200 if body else 403)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *args: object) -> None:
                del args

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)

    def page(self, query: dict[str, str]) -> bytes:
        after = query.get("continuation-token", query.get("start-after", ""))
        if "continuation-token" not in query:
            self.asked_after.append(after)
        if self.pages_left is not None:
            if self.pages_left == 0:
                return b""
            self.pages_left -= 1
        rest = [key for key in self.keys if key > after]
        page = rest[: self.PAGE]
        contents = "".join(
            f"<Contents><Key>{key}</Key><Size>7</Size><ETag>e</ETag>"
            "<LastModified>2026-01-01T00:00:00Z</LastModified></Contents>"
            for key in page
        )
        more = len(rest) > len(page)
        token = f"<NextContinuationToken>{page[-1]}</NextContinuationToken>" if more else ""
        truncated = f"<IsTruncated>{str(more).lower()}</IsTruncated>"
        return f"<ListBucketResult>{truncated}{token}{contents}</ListBucketResult>".encode()

    def bucket(self) -> Bucket:
        options = {
            "endpoint": f"http://127.0.0.1:{self.server.server_address[1]}",
            "access_key_id": "id",
            "secret_access_key": "key",
            "region": "us-east-1",
        }
        return open_bucket("s3://logs", options=options)


@pytest.fixture
def paged() -> Iterator[PagedStore]:
    store = PagedStore([f"car/day/log-{number:05d}.mcap" for number in range(10_000)])
    thread = Thread(target=store.server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield store
    store.server.shutdown()
    store.server.server_close()
    thread.join()


def memory(*keys: str) -> Bucket:
    bucket = open_bucket("memory://")
    for key in keys:
        bucket.put(key, b"1234567")
    return bucket


def log_ids(world: World) -> list[str]:
    return [log.log_id for log in world.ledger.status().logs]


def test_a_listing_tells_what_it_saw_and_when(world: World) -> None:
    watch = BucketWatch(memory("a.mcap", "b_0.mcap", "b_1.mcap", "notes.txt"), world.ledger)
    assert (watch.seen.last_success_s, watch.recordings, watch.listed_at_s) == (None, None, None)
    assert watch.list_once().new == ("a", "b")
    seen = watch.seen
    assert (seen.recordings, seen.objects, seen.bytes) == (2, 3, 21)
    assert (seen.last_success_s, watch.recordings) == (world.clock.now_s, 2)
    assert seen.duration_s > 0
    assert watch.listed_at_s is not None


@pytest.mark.parametrize(
    ("include", "exclude", "found"),
    [
        ((), (), ["bus/1/a", "bus/2/a", "car/1/a"]),
        (("bus/*",), (), ["bus/1/a", "bus/2/a"]),
        (("car/*", "*/2/*"), (), ["bus/2/a", "car/1/a"]),
        ((), ("*/1/*",), ["bus/2/a"]),
        (("bus/*",), ("bus/2/*", "none"), ["bus/1/a"]),
        (("bus",), (), []),
        (("BUS/*",), (), []),
    ],
)
def test_patterns_choose_by_the_whole_key(
    world: World, include: tuple[str, ...], exclude: tuple[str, ...], found: list[str]
) -> None:
    bucket = memory("bus/1/a.mcap", "bus/2/a.mcap", "car/1/a.mcap")
    watch = BucketWatch(bucket, world.ledger, include=include, exclude=exclude)
    watch.list_once()
    assert log_ids(world) == found


def test_a_listing_that_breaks_off_goes_on_after_the_last_key(
    world: World, paged: PagedStore
) -> None:
    watch = BucketWatch(paged.bucket(), world.ledger)
    paged.pages_left = 3
    with pytest.raises(BucketRefusedError, match="refuses these credentials"):
        watch.list_once()
    assert log_ids(world) == []
    with pytest.raises(BucketRefusedError):
        watch.list_once()
    paged.pages_left = None
    assert len(watch.list_once().new) == 10_000
    assert paged.asked_after == ["", "car/day/log-02999.mcap", "car/day/log-02999.mcap"]
    assert (watch.seen.objects, watch.seen.bytes) == (10_000, 70_000)
    assert watch.seen.errors == {"unreachable": 0, "refused": 2}
    assert watch.list_once() == type(watch.list_once())()
    assert paged.asked_after[3:] == ["", ""]


def test_a_listing_that_shows_nothing_new_still_takes_up_what_seemed_to_change(
    world: World,
) -> None:
    watch = BucketWatch(memory("a.mcap"), world.ledger)
    watch.list_once()
    assert world.fail(world.plan_lease(), replaced=True).ok
    assert world.ledger.stale_logs() == ["a"]
    world.clock.now_s += 10
    watch.list_once()
    assert world.ledger.stale_logs() == []
    assert watch.seen.last_success_s == world.clock.now_s


def test_a_listing_that_broke_off_long_ago_begins_anew(world: World, paged: PagedStore) -> None:
    clock = Clock()
    watch = BucketWatch(paged.bucket(), world.ledger, elapsed_s=clock)
    paged.pages_left = 3
    with pytest.raises(BucketRefusedError):
        watch.list_once()
    clock.now_s += RESUME_WITHIN_S + 1
    paged.pages_left, paged.keys = None, paged.keys[5:15]
    watch.list_once()
    assert paged.asked_after == ["", ""]
    assert watch.seen.objects == 10


def test_an_error_in_mid_run_leaves_what_was_seen(world: World, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "a.mcap").write_bytes(b"x")
    watch = BucketWatch(open_bucket(str(folder)), world.ledger)
    watch.list_once()
    before = watch.seen
    folder.rename(tmp_path / "elsewhere")
    with pytest.raises(BucketUnreachableError, match="is its disk mounted"):
        watch.list_once()
    assert watch.seen.errors == {"unreachable": 1, "refused": 0}
    assert watch.seen.last_success_s == before.last_success_s
    assert log_ids(world) == ["a"]


def test_a_bucket_that_is_suddenly_empty_is_believed_when_it_stays_so(
    world: World, tmp_path: Path
) -> None:
    log = tmp_path / "logs" / "a.mcap"
    log.parent.mkdir()
    log.write_bytes(b"x")
    clock = Clock()

    def watching() -> BucketWatch:
        bucket = open_bucket(str(log.parent))
        return BucketWatch(bucket, world.ledger, settle_s=30.0, elapsed_s=clock)

    watch = watching()
    watch.list_once()
    log.unlink()
    watch = watching()  # a service that was started meanwhile knows it from the ledger
    with structlog.testing.capture_logs() as said:
        for _ in range(3):
            assert watch.list_once().deleted == ()
            clock.now_s += 10
        assert watch.seen.recordings == 0
        assert log_ids(world) == ["a"]
        assert watch.list_once().deleted == ("a",)
        watch.list_once()
        log.write_bytes(b"x")
        assert watch.list_once().new == ("a",)
    events = [entry["event"] for entry in said]
    assert [event for event in events if "empty" in event or "again" in event] == [
        "bucket is suddenly empty; is its disk mounted? logs are kept for now",
        "bucket stays empty: its logs count as deleted",
        "bucket contains logs again",
    ]


def test_a_disk_that_is_mounted_again_costs_nothing(world: World, tmp_path: Path) -> None:
    log = tmp_path / "logs" / "a.mcap"
    log.parent.mkdir()
    log.write_bytes(b"x")
    clock = Clock()
    bucket = open_bucket(str(log.parent))
    watch = BucketWatch(bucket, world.ledger, settle_s=30.0, elapsed_s=clock)
    watch.list_once()
    world.mine_all()
    newest = world.ledger.last_seq()
    aside = log.rename(tmp_path / "a.mcap")
    for _ in range(5):  # each time shorter than it takes to be believed
        watch.list_once()
        clock.now_s += 20
        aside.rename(log)
        watch.list_once()
        log.rename(aside)
    assert world.ledger.last_seq() == newest


def test_a_listing_of_once_believes_an_empty_bucket(world: World, tmp_path: Path) -> None:
    log = tmp_path / "logs" / "a.mcap"
    log.parent.mkdir()
    log.write_bytes(b"x")
    bucket = open_bucket(str(log.parent))
    BucketWatch(bucket, world.ledger).list_once()
    log.unlink()
    assert BucketWatch(bucket, world.ledger).list_once().deleted == ("a",)


def test_a_bucket_that_was_never_filled_is_empty_at_once(world: World) -> None:
    watch = BucketWatch(memory(), world.ledger, settle_s=30.0)
    with structlog.testing.capture_logs() as said:
        watch.list_once()
        watch.list_once()
    assert [entry["event"] for entry in said] == ["no logs in the bucket"]


@pytest.mark.parametrize("settle_s", [0.0, 30.0])
@pytest.mark.parametrize("logs", [(), ("b.mcap",)])
def test_another_bucket_is_refused_before_it_is_taken_over(
    world: World, tmp_path: Path, settle_s: float, logs: tuple[str, ...]
) -> None:
    for folder, names in (("one", ("a.mcap",)), ("other", logs)):
        (tmp_path / folder).mkdir()
        for name in names:
            (tmp_path / folder / name).write_bytes(b"x")
    BucketWatch(open_bucket(str(tmp_path / "one")), world.ledger).list_once()
    other = BucketWatch(open_bucket(str(tmp_path / "other")), world.ledger, settle_s=settle_s)
    with pytest.raises(OtherBucketError, match=r"/one: of its 1 logs .*/other holds 0"):
        other.list_once()
    assert log_ids(world) == ["a"]


def entries_named(said: list[EventDict]) -> list[str]:
    return [each["entry"] for each in said if each["event"] == "entry of the bucket skipped"]


def test_an_odd_entry_costs_itself_and_is_logged_once(world: World, tmp_path: Path) -> None:
    folder = tmp_path / "logs"
    folder.mkdir()
    (folder / "a.mcap").write_bytes(b"x")
    (folder / "b\x1b[31m.mcap").write_bytes(b"x")
    (folder / "c.mcap").symlink_to("c.mcap")
    (folder / "skip\n.tmp").write_bytes(b"x")
    watch = BucketWatch(open_bucket(str(folder)), world.ledger, exclude=("skip*",))
    with structlog.testing.capture_logs() as said:
        assert watch.list_once().new == ("a",)
        watch.list_once()
    assert sorted(entries_named(said)) == [r"b\x1b[31m.mcap", "c.mcap"]
    assert watch.seen.skipped == 2
    named = [f"{each.name} {each.why}" for each in world.ledger.status().skipped.named]
    assert named == [
        r"b\x1b[31m.mcap has a name that holds a control character",
        "c.mcap is a link in a loop of links",
    ]
    (folder / "c.mcap").unlink()
    watch.list_once()
    assert watch.seen.skipped == 1
    (folder / "c.mcap").symlink_to("c.mcap")
    with structlog.testing.capture_logs() as said:
        watch.list_once()
    assert entries_named(said) == ["c.mcap"]


def test_what_is_no_log_is_counted_and_the_first_are_named_for_the_status(world: World) -> None:
    keys = [f"pictures/{number:02}.jpg" for number in range(14)]
    bucket = memory("a.mcap", "a.bag", "notes/b.txt", *keys)
    watch = BucketWatch(bucket, world.ledger, exclude=("notes/*",))
    watch.list_once()
    skipped = world.ledger.status().skipped
    assert skipped.count == 15
    assert [each.name for each in skipped.named] == ["a.bag", *keys[:9]]
    assert skipped_phrases(skipped, most=1) == ["a.bag is no .mcap file", "14 more entries"]
    watch = BucketWatch(bucket, world.ledger, include=("*.mcap",))
    watch.list_once()
    assert world.ledger.status().skipped == SkippedEntries()


def test_a_key_that_is_too_long_for_a_log_id_is_left_out(world: World) -> None:
    deep = "/".join(["中" * 80] * 14)
    watch = BucketWatch(memory("a.mcap", f"{deep}.mcap"), world.ledger)
    assert watch.list_once().new == ("a",)
    assert watch.seen.skipped == 1


class HidingBucket(Bucket):
    """A folder of which a subfolder may not be read."""

    def __init__(self, folder: Path) -> None:
        opened = open_bucket(str(folder))
        super().__init__(opened._store, url=opened.url, folder=folder)
        self.hidden = ""

    def list(
        self,
        prefix: str = "",
        start_after: str | None = None,
        *,
        on_skipped: Callable[[Skipped], None] = lambda skipped: None,
    ) -> Iterator[ObjectMeta]:
        if self.hidden:
            on_skipped(Skipped.of(self.hidden, "may not be read", hides=self.hidden))
        for found in super().list(prefix, start_after, on_skipped=on_skipped):
            if not self.hidden or not found.key.startswith(f"{self.hidden}/"):
                yield found


def test_logs_in_a_folder_that_may_not_be_read_any_more_do_not_count_as_deleted(
    world: World, tmp_path: Path
) -> None:
    for key in ("car/a.mcap", "car-2/b.mcap"):
        (tmp_path / "logs" / key).parent.mkdir(parents=True)
        (tmp_path / "logs" / key).write_bytes(b"x")
    bucket = HidingBucket(tmp_path / "logs")
    watch = BucketWatch(bucket, world.ledger)
    watch.list_once()
    bucket.hidden = "car"
    (tmp_path / "logs" / "new.mcap").write_bytes(b"x")
    result = watch.list_once()
    assert (result.new, result.deleted) == (("new",), ())
    started_meanwhile = BucketWatch(bucket, world.ledger)
    with pytest.raises(BucketRefusedError, match=r"logs of the folder car/ are recorded"):
        started_meanwhile.list_once()
    assert "permit it" in started_meanwhile.seen.problem
    excluding = BucketWatch(bucket, world.ledger, exclude=("car/*",))
    assert excluding.list_once().deleted == ("car/a",)


def test_a_folder_that_never_could_be_read_is_left_out(world: World, tmp_path: Path) -> None:
    (tmp_path / "logs" / "lost+found").mkdir(parents=True)
    (tmp_path / "logs" / "a.mcap").write_bytes(b"x")
    bucket = HidingBucket(tmp_path / "logs")
    bucket.hidden = "lost+found"
    for _ in range(2):
        watch = BucketWatch(bucket, world.ledger)
        watch.list_once()
        assert watch.seen.skipped == 1
    assert log_ids(world) == ["a"]
