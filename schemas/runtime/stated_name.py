"""Name that a request gives its asker, for the audit log: a user of the page, or of a machine."""

import os
import pwd
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final

_STATED: Final[ContextVar[str]] = ContextVar("stated name", default="")


@contextmanager
def stating(name: str) -> Iterator[None]:
    """State a name within the block, in this thread or task and what it starts."""
    token = _STATED.set(name)
    try:
        yield
    finally:
        _STATED.reset(token)


def stated_name() -> str:
    """Return the stated name, else that of the user of this process."""
    return _STATED.get() or _user()


def _user() -> str:
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # in a container, where users have numbers only
        return str(os.getuid())
