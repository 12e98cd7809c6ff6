"""Bounded set of HTTP connections; a new one replaces the oldest that waits."""

import socket
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

MOST_CONNECTIONS: Final = 64
"""Connections at a time; each has a thread."""

MOST_OF_AN_ADDRESS: Final = 32
"""Connections at a time from one address; all clients behind a proxy share one."""


@dataclass(slots=True)
class _Client:
    address: str
    since_s: float = field(default_factory=time.monotonic)
    is_answered: bool = False
    """True while its page is being made; such a connection is neither idle nor slow."""


class Clients:
    """Open connections, bounded in all and for each address.

    A new connection is always accepted. It replaces the oldest connection that only waits, either
    for the rest of a request or for an answer to be read. So slow clients cannot keep out a probe,
    which sends its request at once. Methods may be called from any thread.
    """

    def __init__(self) -> None:
        self._clients: dict[socket.socket, _Client] = {}
        self._guard = threading.Lock()

    def admit(self, connection: socket.socket, address: str) -> bool:
        """Accept a new connection, and drop another one if there are too many.

        Args:
            connection: The new connection.
            address: Address of its client, without the port.

        Returns:
            True if it was accepted; False if too many are being answered at this moment.
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

    def replace(self, connection: socket.socket, by: socket.socket) -> None:
        """Put the encrypted side of a connection in place of the plain one."""
        with self._guard:
            client = self._clients.pop(connection, None)
            if client is not None:
                self._clients[by] = client

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
        """Shut down every connection; the threads that wait for them notice and end."""
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
