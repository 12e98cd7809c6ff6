"""An object store on a folder that speaks just enough S3, and refuses or stalls when told to.

What it is for: credentials that expire and come back, and single objects that are forbidden, at a
moment that the test chooses. That the product works with a real store is tested on one.
"""

import threading
from contextlib import AbstractContextManager
from hashlib import md5
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self
from urllib.parse import unquote, urlsplit
from xml.sax.saxutils import escape

REFUSAL = b"<Error><Code>InvalidAccessKeyId</Code><Message>no</Message></Error>"


MOST_DIGESTED: Final = 1 << 28
"""Bytes of a file up to which its etag is a digest."""


class SmallS3(AbstractContextManager["SmallS3"]):
    """Buckets are folders of `root`.

    Attributes:
        refuses: Words; a request whose path, or `METHOD /path`, contains one is answered with 403.
        stalls: Whether requests get no answer at all until this is false again.
        asked: Every request so far, as `METHOD /path`.
    """

    def __init__(self, root: Path) -> None:
        self.root, self.refuses, self.asked = root, set[str](), list[str]()
        self._flowing = threading.Event()
        self._flowing.set()
        self._server = _Server(("127.0.0.1", 0), _handler_of(self))
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    @property
    def environment(self) -> dict[str, str]:
        """What makes a client use it."""
        return {
            "AWS_ENDPOINT": f"http://127.0.0.1:{self._server.server_address[1]}",
            "AWS_ACCESS_KEY_ID": "id",
            "AWS_SECRET_ACCESS_KEY": "secret",
            "AWS_REGION": "nowhere",
        }

    @property
    def stalls(self) -> bool:
        return not self._flowing.is_set()

    @stalls.setter
    def stalls(self, stalls: bool) -> None:
        if stalls:
            self._flowing.clear()
        else:
            self._flowing.set()

    def refused(self, method: str, path: str) -> bool:
        """Note a request, wait while the store stalls, and say whether it is refused."""
        said = f"{method} {path}"
        self.asked.append(said)
        self._flowing.wait()
        return any(word in said for word in self.refuses)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._flowing.set()
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a client that did not wait for its answer."""


def _handler_of(store: SmallS3) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            path = unquote(urlsplit(self.path).path)
            file = store.root / path.strip("/")
            if store.refused("GET", path):
                self._send(HTTPStatus.FORBIDDEN, REFUSAL)
            elif file.is_dir():
                self._send(HTTPStatus.OK, _listing(file).encode())
            elif file.is_file():
                self._send_range(file)
            else:
                self._send(HTTPStatus.NOT_FOUND, b"<Error><Code>NoSuchKey</Code></Error>")

        def _send_range(self, path: Path) -> None:
            size = path.stat().st_size
            first, last = 0, size - 1
            if asked := self.headers.get("Range"):
                first, last = map(int, asked.removeprefix("bytes=").split("-"))
                last = min(last, size - 1)
            with path.open("rb") as file:
                file.seek(first)
                data = file.read(last + 1 - first)
            self._send(
                HTTPStatus.PARTIAL_CONTENT if asked else HTTPStatus.OK,
                data,
                {
                    "ETag": _etag_of(path),
                    "Last-Modified": "Mon, 02 Mar 2026 00:00:00 GMT",
                    "Content-Range": f"bytes {first}-{last}/{size}",
                },
            )

        def do_PUT(self) -> None:
            path = unquote(urlsplit(self.path).path)
            data = self.rfile.read(int(self.headers["Content-Length"]))
            if store.refused("PUT", path):
                self._send(HTTPStatus.FORBIDDEN, REFUSAL)
                return
            file = store.root / path.strip("/")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
            self._send(HTTPStatus.OK, b"", {"ETag": _etag(data)})

        def log_message(self, *_: Any) -> None:
            """Say nothing."""

        def _send(
            self, status: HTTPStatus, body: bytes, headers: dict[str, str] | None = None
        ) -> None:
            self.send_response(status)
            for name, value in (headers or {}).items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

    return Handler


def _listing(folder: Path) -> str:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    contents = "".join(
        f"<Contents><Key>{escape(path.relative_to(folder).as_posix())}</Key>"
        f"<LastModified>2026-03-02T00:00:00.000Z</LastModified>"
        f"<ETag>{escape(_etag_of(path))}</ETag><Size>{path.stat().st_size}</Size>"
        "</Contents>"
        for path in files
    )
    return f"<ListBucketResult><IsTruncated>false</IsTruncated>{contents}</ListBucketResult>"


def _etag(data: bytes) -> str:
    return f'"{md5(data, usedforsecurity=False).hexdigest()}"'


def _etag_of(path: Path) -> str:
    """Return the digest of a file's bytes; of a huge one its size and time, as after an upload in
    parts, where the etag is no digest of the bytes either.
    """
    stat = path.stat()
    if stat.st_size > MOST_DIGESTED:
        return f'"{stat.st_mtime_ns:x}-{stat.st_size:x}"'
    return _etag(path.read_bytes())
