"""The clients connected to an HTTP endpoint: bounded, and the oldest that waits makes room."""

import socket
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

MOST_CONNECTIONS: Final = 64
"""Connections at a time; each has a thread."""

MOST_OF_AN_ADDRESS: Final = 32
"""Connections at a time of one address; behind a proxy, all its clients have one."""


@dataclass(slots=True)
class _Client:
    address: str
    since_s: float = field(default_factory=time.monotonic)
    is_answered: bool = False
    """A page is being made for it: neither idle nor slow."""


class Clients:
    """The open connections, bounded in all and for each address.

    A newcomer is let in: for it, the oldest connection is dropped that only waits, be it for the
    rest of a request or for an answer to be taken. So slow clients cannot keep a probe out, which
    sends its request at once. Methods may be called from any thread.
    """

    def __init__(self) -> None:
        self._clients: dict[socket.socket, _Client] = {}
        self._guard = threading.Lock()

    def admit(self, connection: socket.socket, address: str) -> bool:
        """Take a newcomer in, and drop another one if it is one too many.

        Args:
            connection: The newcomer.
            address: Of its client, without the port.

        Returns:
            True if it is in; False if too many are being answered at this moment.
        """
        with self._guard:
            of_address = [key for key, one in self._clients.items() if one.address == address]
            if len(of_address) >= MOST_OF_AN_ADDRESS:
                has_room = self._drop_oldest(of_address)
            else:
                has_room = len(self._clients) < MOST_CONNECTIONS or self._drop_oldest(
                    list(self._clients)
                )
            if has_room:
                self._clients[connection] = _Client(address)
            return has_room

    def is_answered(self, connection: socket.socket, answered: bool) -> None:
        """Note that a page is being made for a client, or no longer."""
        with self._guard:
            client = self._clients.get(connection)
            if client is not None:
                client.is_answered = answered

    def forget(self, connection: socket.socket) -> None:
        """Forget a connection that is about to be closed."""
        with self._guard:
            self._clients.pop(connection, None)

    def drop_all(self) -> None:
        """End every connection; the threads that wait for them go on and see it."""
        with self._guard:
            for connection in self._clients:
                _end(connection)

    def _drop_oldest(self, among: list[socket.socket]) -> bool:
        waiting = [key for key in among if not self._clients[key].is_answered]
        if not waiting:
            return False
        oldest = min(waiting, key=lambda key: self._clients[key].since_s)
        del self._clients[oldest]
        _end(oldest)
        return True


def _end(connection: socket.socket) -> None:
    with suppress(OSError):  # it may have left this moment
        connection.shutdown(socket.SHUT_RDWR)
