"""A receiver of webhooks on a real port: what it was sent, and what it answers."""

import base64
import hmac
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

SECRET = base64.b64encode(b"s" * 32).decode()


class Receiver:
    """Keeps the deliveries that it took.

    Attributes:
        url: Its address.
        taken: Bodies of the deliveries that it answered with 200, in order.
        refused: Number of the others.
    """

    def __init__(self, port: int) -> None:
        self.url = f"http://127.0.0.1:{port}/hook"
        self.taken: list[dict[str, Any]] = []
        self.refused = 0
        self.status: Callable[[int], int] = lambda _: 200
        self._lock = threading.Lock()

    def answer(self, headers: dict[str, str], body: bytes) -> int:
        """Check the signature as a receiver does, and return the status."""
        signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
        digest = hmac.new(base64.b64decode(SECRET), signed, sha256).digest()
        assert headers["webhook-signature"] == f"v1,{base64.b64encode(digest).decode()}"
        event = json.loads(body)
        assert event["id"] == headers["webhook-id"]
        with self._lock:
            status = self.status(len(self.taken))
            if status == 200:
                self.taken.append(event)
            else:
                self.refused += 1
        return status

    def ids(self) -> list[str]:
        with self._lock:
            return [event["id"] for event in self.taken]

    def of(self, kind: str) -> list[dict[str, Any]]:
        with self._lock:
            return [event["data"] for event in self.taken if event["type"] == kind]


@contextmanager
def receiver() -> Iterator[Receiver]:
    """Run a receiver."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["content-length"]))
            headers = {name.lower(): value for name, value in self.headers.items()}
            self.send_response(made.answer(headers, body))
            self.send_header("location", "http://127.0.0.1:9/elsewhere")
            self.send_header("content-length", "0")
            self.end_headers()

        def log_message(self, *args: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        made = Receiver(server.server_address[1])
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield made
        finally:
            server.shutdown()
            thread.join()
