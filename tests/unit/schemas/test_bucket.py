"""Buckets in memory and in folders keep the contract; others are refused in one clear sentence."""

from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from schemas.errors import BucketRefusedError, BucketUnreachableError, ObjectChangedError
from schemas.transport.bucket import Bucket, open_bucket, open_object
from tests.contracts.bucket_contract import BucketContract

KEY_ID, SECRET = "AKIAPUBLICID", "s3cr3t/of+the/car"
OPTIONS = {"access_key_id": KEY_ID, "secret_access_key": SECRET, "region": "us-east-1"}


class TestMemoryBucket(BucketContract):
    def make_bucket(self) -> Bucket:
        return open_bucket("memory://")


class TestFolderBucket(BucketContract):
    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path: Path) -> None:
        self.folder = tmp_path

    def make_bucket(self) -> Bucket:
        return open_bucket(self.folder.as_uri())


def test_a_bare_path_is_a_folder(tmp_path: Path) -> None:
    (tmp_path / "one log").mkdir()
    (tmp_path / "one log" / "a.mcap").write_bytes(b"x")
    for url in (str(tmp_path), tmp_path.as_uri()):
        assert [found.key for found in open_bucket(url).list()] == ["one log/a.mcap"]
        assert open_bucket(url).url == tmp_path.as_uri()


@pytest.mark.parametrize(
    ("url", "says"),
    [
        pytest.param("ftp://host/logs", "no bucket URL: ftp://host/logs; use file", id="scheme"),
        pytest.param("s3:///logs", "no bucket URL", id="no bucket in it"),
        pytest.param("/nowhere/logs", "folder does not exist: /nowhere/logs", id="no folder"),
        pytest.param("file:///nowhere/logs", "folder does not exist", id="no folder by URL"),
        pytest.param("s3://me:s3cr3t@logs/a", "must not carry credentials", id="credentials"),
    ],
)
def test_a_wrong_url_is_refused(url: str, says: str) -> None:
    with pytest.raises(BucketRefusedError, match=says) as caught:
        open_bucket(url)
    assert "s3cr3t" not in str(caught.value)


def test_a_folder_that_is_gone_is_away_and_none_of_its_objects_replaced(tmp_path: Path) -> None:
    """Else every shard that waits would use up an attempt while a disk is not mounted."""
    folder = tmp_path / "disk"
    (folder / "car-1").mkdir(parents=True)
    (folder / "car-1" / "a.mcap").write_bytes(b"x")
    bucket = open_bucket(str(folder))
    [listed] = bucket.list()
    folder.rename(tmp_path / "elsewhere")
    for use in (
        lambda: list(bucket.list()),
        lambda: bucket.head(listed.key),
        lambda: bucket.read_range(listed.key, 0, 1, listed.etag),
        lambda: bucket.read_all(listed.key),
    ):
        with pytest.raises(BucketUnreachableError, match="is its disk mounted"):
            use()
    (tmp_path / "elsewhere").rename(folder)
    assert bucket.read_range(listed.key, 0, 1, listed.etag) == b"x"


def test_a_file_is_no_folder_of_logs(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")
    with pytest.raises(BucketRefusedError, match="is a file, not a folder"):
        open_bucket(str(tmp_path / "a.mcap"))


def test_a_folder_for_artifacts_is_made(tmp_path: Path) -> None:
    bucket = open_bucket(str(tmp_path / "new" / "folder"), create=True)
    bucket.put("a", b"x")
    assert (tmp_path / "new" / "folder" / "a").read_bytes() == b"x"


def test_an_object_is_found_with_three_segments_of_its_path(tmp_path: Path) -> None:
    path = tmp_path / "fleet" / "car" / "day" / "drive.mcap"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"x")
    bucket, key = open_object(str(path))
    assert (bucket.url, key) == ((tmp_path / "fleet").as_uri(), "car/day/drive.mcap")
    assert open_object(path.as_uri())[1] == key


def test_an_object_of_a_store_is_found_by_its_whole_key() -> None:
    bucket, key = open_object("s3://logs/fleet/car/day/drive.mcap")
    assert (bucket.url, key) == ("s3://logs", "fleet/car/day/drive.mcap")
    with pytest.raises(BucketRefusedError, match="a bucket, not an object"):
        open_object("s3://logs")
    with pytest.raises(BucketRefusedError, match="no such file"):
        open_object("/nowhere/a.mcap")


@contextmanager
def store_that_answers(status: int, body: str) -> Iterator[str]:
    """A server that answers everything alike; gives its endpoint."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body.encode())

        def log_request(self, code: object = "-", size: object = "-") -> None:
            """Keep the test's output clean."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def s3_error(code: str) -> str:
    return (
        f"<?xml version='1.0'?><Error><Code>{code}</Code><Message>no</Message>"
        f"<AWSAccessKeyId>{KEY_ID}</AWSAccessKeyId></Error>"
    )


@pytest.mark.parametrize(
    ("status", "code", "says"),
    [
        pytest.param(403, "SignatureDoesNotMatch", r"refuses these credentials", id="secret"),
        pytest.param(403, "AccessDenied", "listing here", id="acl"),
        pytest.param(403, "InvalidAccessKeyId", "does not know these credentials", id="key"),
        pytest.param(403, "RequestTimeTooSkewed", "set this machine's clock", id="clock"),
        pytest.param(400, "ExpiredToken", r"expired \(ExpiredToken\): set AWS_", id="token"),
        pytest.param(404, "NoSuchBucket", "no such bucket", id="bucket"),
        pytest.param(400, "AuthorizationHeaderMalformed", "check bucket, region", id="region"),
        pytest.param(301, "PermanentRedirect", "sends the request elsewhere", id="another region"),
    ],
)
def test_what_a_store_refuses_is_said_without_credentials(
    status: int, code: str, says: str
) -> None:
    with store_that_answers(status, s3_error(code)) as endpoint:
        bucket = open_bucket("s3://logs", options={**OPTIONS, "endpoint": endpoint})
        with pytest.raises(BucketRefusedError, match=says) as caught:
            list(bucket.list())
    said = f"{caught.value} {caught.value!r} {bucket!r}"
    assert "s3://logs" in said
    assert KEY_ID not in said
    assert SECRET not in said
    assert caught.value.__cause__ is None


def test_a_store_whose_object_was_replaced_says_so() -> None:
    with store_that_answers(412, s3_error("PreconditionFailed")) as endpoint:
        bucket = open_bucket("s3://logs", options={**OPTIONS, "endpoint": endpoint})
        with pytest.raises(ObjectChangedError):
            bucket.read_range("a.mcap", 0, 10, '"old"')


def test_a_key_that_no_log_may_have_is_named_escaped() -> None:
    contents = (
        "<ListBucketResult><IsTruncated>false</IsTruncated><Contents><Key>car/a\x1b[31m.mcap</Key>"
        "<Size>7</Size><ETag>e</ETag><LastModified>2026-01-01T00:00:00Z</LastModified></Contents>"
        "</ListBucketResult>"
    )
    with store_that_answers(200, contents) as endpoint:
        bucket = open_bucket("s3://logs", options={**OPTIONS, "endpoint": endpoint})
        with pytest.raises(BucketRefusedError, match=r"'car/a\\x1b\[31m.mcap': rename") as caught:
            list(bucket.list())
    assert "\x1b" not in str(caught.value)


def test_opening_a_bucket_asks_nothing_of_the_store() -> None:
    bucket = open_bucket("s3://logs/fleet?secret=1", options=OPTIONS)
    assert repr(bucket) == "Bucket('s3://logs/fleet')"
