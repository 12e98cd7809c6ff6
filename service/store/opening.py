"""Opening of the configured database: PostgreSQL by URL, else SQLite in the state folder."""

import re
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Final, Protocol

from service.errors import StateUnusableError
from service.settings.hidden_passwords import shown
from service.store.engine import (
    Store,
    StoreUnavailableError,
    has_database,
    open_store,
    open_store_at,
    open_store_to_read,
)
from service.store.single_writer_lock import SoleService

_NO: Final = re.compile(
    r"password authentication failed for user \"[^\"]*\"|no password supplied"
    r"|no pg_hba\.conf entry for [^\n]*|(?:role|database) \"[^\"]*\" does not exist"
)
"""Messages of a refused PostgreSQL login, which has no error number in its driver. A server with
messages in another language is treated as one that does not answer.
"""


ELSEWHERE: Final = "postgresql.txt"
"""File in a state folder whose ledger is a PostgreSQL: its address, without a password."""


class WhereStateLies(Protocol):
    """Settings that locate the state."""

    @property
    def state(self) -> Path:
        """Folder of lock and overlays, and of the database if it is SQLite."""
        ...

    @property
    def database(self) -> str:
        """URL of a PostgreSQL database; empty: SQLite."""
        ...


def open_ledger_store(settings: WhereStateLies, *, session_name: str = "") -> Store:
    """Open the database for writing; create or migrate it as needed.

    The caller holds the lock of the state folder, and `sole_service` for PostgreSQL.

    Args:
        settings: Locate it.
        session_name: Name of the sessions of a PostgreSQL.

    Raises:
        StateUnusableError: If a newer version wrote it, it is no database, or refuses the login; or
            if the state folder belongs to a PostgreSQL, and the settings name none.
        StoreUnavailableError: If it is locked, the disk is full, or the server does not answer.
    """
    if settings.database:
        with _refusals_said(settings.database):
            store = open_store_at(settings.database, session_name=session_name)
        _note_database(settings)
        return store
    _refuse_if_elsewhere(settings.state)
    return open_store(settings.state)


def open_ledger_store_to_read(settings: WhereStateLies) -> Store:
    """Open the database for reading only, with or without a running service.

    Raises:
        StateUnusableError: If there is none, its version is not this program's, or it refuses the
            login.
        StoreUnavailableError: If the server does not answer.
    """
    if settings.database:
        with _refusals_said(settings.database):
            return open_store_at(settings.database, read_only=True)
    return open_store_to_read(settings.state)


def sole_service(settings: WhereStateLies) -> AbstractContextManager[SoleService | None]:
    """Take the exclusive right to serve a PostgreSQL database; SQLite needs only the folder's lock.

    Raises:
        StateInUseError: If another service holds it.
        StateUnusableError: If the server refuses the login.
        StoreUnavailableError: If the server does not answer.
    """
    if settings.database:
        with _refusals_said(settings.database):
            return SoleService(settings.database)
    return nullcontext()


@contextmanager
def _refusals_said(url: str) -> Iterator[None]:
    """Turn a refused login into a permanent error; a missing server stays transient."""
    try:
        yield
    except StoreUnavailableError as error:
        refusal = _NO.search(str(error.__cause__))
        if refusal is None:
            raise
        raise StateUnusableError(
            f"the database refuses the login: {refusal.group()} ({shown(url)}); correct user, "
            "password (in `database`, PGPASSWORD or .pgpass) or the database's name"
        ) from error


def _note_database(settings: WhereStateLies) -> None:
    """Note in the state folder which PostgreSQL has its ledger; without a folder, nowhere."""
    file = settings.state / ELSEWHERE
    with suppress(OSError):  # it only guards against a setting that is lost later
        if settings.state.is_dir():
            file.write_text(f"{shown(settings.database)}\n", encoding="utf-8")


def _refuse_if_elsewhere(folder: Path) -> None:
    """Refuse to begin an empty ledger in a folder whose ledger is a PostgreSQL."""
    file = folder / ELSEWHERE
    if file.exists() and not has_database(folder):
        where = file.read_text(encoding="utf-8").strip()
        raise StateUnusableError(
            f"the ledger of this state is the PostgreSQL {where}, and no database is set: set "
            f"COUNTERPOINT_DATABASE; or delete {file} for an empty ledger: everything is mined "
            "again"
        )
