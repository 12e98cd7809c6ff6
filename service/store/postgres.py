"""Connections to PostgreSQL: their patience with a network, and the end of every wait on them."""

import os
import socket
from contextlib import suppress
from typing import Any, Final
from weakref import WeakSet

from sqlalchemy import Engine, create_engine, event

from service.errors import StateUnusableError

PATIENCE: Final = {
    "connect_timeout": 5,
    "keepalives_idle": 5,
    "keepalives_interval": 3,
    "keepalives_count": 3,
    "tcp_user_timeout": 15_000,
}
"""Parameters of a PostgreSQL connection, by which a network that is cut is noticed within 15 s;
seconds, the last one milliseconds.
"""


def postgres_engine(url: str, **options: Any) -> Engine:
    """Make an engine on a PostgreSQL database; it connects on first use.

    Raises:
        StateUnusableError: If the driver is not installed.
    """
    try:
        return create_engine(url, **options)
    except ModuleNotFoundError as error:
        raise StateUnusableError(
            f"PostgreSQL needs the extra `postgres`: pip install 'counterpoint[postgres]' ({error})"
        ) from None


class OpenSockets:
    """Sockets of all connections of a PostgreSQL engine.

    The driver waits without a limit for a server that a broken network hides. Shutting a socket
    makes that wait fail at once, as if the server had closed the connection.
    """

    def __init__(self, engine: Engine) -> None:
        """Note every further connection of this engine."""
        self._connections: WeakSet[Any] = WeakSet()
        event.listen(engine, "connect", lambda raw, _record: self._connections.add(raw))

    def shut(self) -> None:
        """Shut the socket of every open connection."""
        for connection in list(self._connections):
            with suppress(Exception):  # a connection that is closed has no socket
                opened = socket.socket(fileno=os.dup(connection.fileno()))
                with opened:
                    opened.shutdown(socket.SHUT_RDWR)
