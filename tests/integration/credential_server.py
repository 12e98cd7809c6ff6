"""A machine's own service for credentials: keys that a store knows today may be others tomorrow."""

import json
import threading
from contextlib import AbstractContextManager
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import Final, Self

from tests.integration.object_store import Identity

_LIFE: Final = timedelta(minutes=4)
"""Said to be left to the keys; whoever asked asks again before each use if that is so little."""

_TOKEN: Final = "let me in"  # noqa: S105  # known to the tests alone


class CredentialServer(AbstractContextManager["CredentialServer"]):
    """Hands the keys of one user to whoever shows the token, as containers ask for theirs.

    Attributes:
        user: Whose keys are given; set another, or the same user's new keys, at any time.
        asked: How often keys were given.
    """

    def __init__(self, user: Identity, folder: Path) -> None:
        self.user, self.asked = user, 0
        self._token = folder / "token"
        self._token.write_text(_TOKEN)
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _handler_of(self))
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,))

    @property
    def environment(self) -> dict[str, str]:
        """What makes a process ask here instead of taking keys from its own variables."""
        return {
            "AWS_CONTAINER_CREDENTIALS_FULL_URI": f"http://127.0.0.1:{self._server.server_port}/",
            "AWS_CONTAINER_AUTHORIZATION_TOKEN_FILE": str(self._token),
        }

    def keys(self) -> bytes:
        self.asked += 1
        ends = datetime.now(UTC) + _LIFE
        return json.dumps(
            {
                "AccessKeyId": self.user.key_id,
                "SecretAccessKey": self.user.secret,
                "Token": "",
                "Expiration": ends.isoformat().replace("+00:00", "Z"),
            }
        ).encode()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()


def _handler_of(server: CredentialServer) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            allowed = self.headers.get("Authorization") == _TOKEN
            body = server.keys() if allowed else b"{}"
            self.send_response(200 if allowed else 403)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_request(self, code: object = "-", size: object = "-") -> None:
            """Keep the test's output clean."""

    return Handler
