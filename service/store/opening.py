"""Opens the database that the settings name: PostgreSQL by URL, else SQLite in the state folder."""

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Protocol

from service.store.engine import Store, open_store, open_store_at, open_store_to_read
from service.store.sole import SoleService


class WhereStateLies(Protocol):
    """What of the settings matters here."""

    @property
    def state(self) -> Path:
        """Folder of lock and overlays, and of the database if it is SQLite."""
        ...

    @property
    def database(self) -> str:
        """URL of a PostgreSQL; empty: SQLite."""
        ...


def open_ledger_store(settings: WhereStateLies) -> Store:
    """Open for writing; made, or brought up to date, as needed.

    Whoever writes holds the lock of the state folder, and `sole_service` for PostgreSQL.

    Raises:
        StateUnusableError: If a newer version wrote it, or it is no database.
        StoreUnavailableError: If it is locked, the disk is full, or the server does not answer.
    """
    return open_store_at(settings.database) if settings.database else open_store(settings.state)


def open_ledger_store_to_read(settings: WhereStateLies) -> Store:
    """Open for reading only, beside a running service or without one.

    Raises:
        StateUnusableError: If there is none, or its version is not this program's.
        StoreUnavailableError: If the server does not answer.
    """
    if settings.database:
        return open_store_at(settings.database, read_only=True)
    return open_store_to_read(settings.state)


def sole_service(settings: WhereStateLies) -> AbstractContextManager[SoleService | None]:
    """Take the exclusive right to serve the database; of SQLite the state folder's lock is enough.

    Raises:
        StateInUseError: If another service holds it.
        StoreUnavailableError: If the server does not answer.
    """
    return SoleService(settings.database) if settings.database else nullcontext()
