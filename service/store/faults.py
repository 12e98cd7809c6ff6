"""Classification of driver errors: transient, unusable state, or a permanently failing statement.

An error that repeats for the same input is never transient: work that causes it would be retried
until it is parked, and the database would be blamed.
"""

import re
import sqlite3
from typing import Any, Final

from sqlalchemy.exc import StatementError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from schemas.errors import CounterpointError, TransientError
from service.errors import StatementFailedError, StateUnusableError


class StoreUnavailableError(TransientError):
    """The database could not finish a transaction: disk full, locked, or its server is away."""


PYTHON_ERRORS: Final = (OverflowError, UnicodeError)
"""Raised in place of a driver's own error: an integer beyond 64 bits, a lone surrogate."""

RAISED: Final = (StatementError, PoolTimeoutError, *PYTHON_ERRORS)
"""Errors of SQLAlchemy and of Python; those of the driver itself come on top."""

_PASSES_IN_SQLITE: Final = frozenset(
    {
        sqlite3.SQLITE_PERM,
        sqlite3.SQLITE_ABORT,
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_NOMEM,
        sqlite3.SQLITE_READONLY,
        sqlite3.SQLITE_INTERRUPT,
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_CANTOPEN,
        sqlite3.SQLITE_PROTOCOL,
        sqlite3.SQLITE_SCHEMA,
    }
)
_DAMAGED_IN_SQLITE: Final = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB})
_PRIMARY: Final = 0xFF
"""Mask of the bits of an SQLite error code that give its kind; the others refine it."""

_PASSES_IN_POSTGRES: Final = ("08", "40", "53", "57", "58", "55P03", "25006", "25P03", "25P04")
"""Beginnings of SQLSTATE: connection, serialization, resources, operator, system; a held lock, a
read-only server, a session that idled too long.
"""

_DAMAGED_IN_POSTGRES: Final = ("XX001", "XX002")

_TOO_MANY_PARAMETERS: Final = "number of parameters must be"
"""Text of libpq, which refuses such a statement itself, with a connection error and no SQLSTATE."""

_NO_DATABASE: Final = re.compile(r'database "[^"]*" does not exist')
"""Text of a refused login, which has no SQLSTATE either."""


def cause_of(error: BaseException) -> BaseException:
    """Return the driver's error, where SQLAlchemy wrapped it."""
    if isinstance(error, StatementError) and error.orig is not None:
        return error.orig
    return error


def names_no_database(error: BaseException) -> bool:
    """Return true if a server answered that it has no database of this name."""
    return _NO_DATABASE.search(str(cause_of(error))) is not None


def fault_of(error: BaseException, driver: Any, *, name: str) -> CounterpointError:
    """Translate an error of the database into one of ours.

    Args:
        error: Error of SQLAlchemy, the driver or Python.
        driver: Module of the driver.
        name: Name of the database, for the message.

    Returns:
        The error to raise in its place.
    """
    cause = cause_of(error)
    if _is_damage(cause):
        return StateUnusableError(
            f"not a database, or a damaged one: {cause} ({name}); "
            "restore it from a copy, or name another folder with --state"
        )
    if _may_pass(cause, driver):
        return StoreUnavailableError(
            f"cannot use the database: {' '.join(str(cause).split())} ({name}); "
            "nothing acknowledged is lost, try again when that is fixed"
        )
    first = (str(cause).splitlines() or [""])[0]
    return StatementFailedError(
        f"the database cannot take this and never will: {type(cause).__name__}: {first} ({name}); "
        "nothing was changed, and it is not tried again; report this sentence"
    )


def _is_damage(cause: BaseException) -> bool:
    code = getattr(cause, "sqlite_errorcode", None)
    if code is not None:
        return (code & _PRIMARY) in _DAMAGED_IN_SQLITE
    return str(getattr(cause, "sqlstate", None)).startswith(_DAMAGED_IN_POSTGRES)


def _may_pass(cause: BaseException, driver: Any) -> bool:
    if isinstance(cause, PoolTimeoutError):
        return True
    code = getattr(cause, "sqlite_errorcode", None)
    if code is not None:
        return (code & _PRIMARY) in _PASSES_IN_SQLITE
    sqlstate = getattr(cause, "sqlstate", None)
    if sqlstate is not None:
        return str(sqlstate).startswith(_PASSES_IN_POSTGRES)
    if driver is sqlite3:  # without a code it is the driver that refuses, not SQLite
        return False
    # Without SQLSTATE no server has judged it: the connection was lost, or could not be made.
    lost = isinstance(cause, (driver.OperationalError, driver.InterfaceError))
    return lost and _TOO_MANY_PARAMETERS not in str(cause)
