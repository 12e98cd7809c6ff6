"""File of tokens: which of them opens the pages, for whom, and in which role.

A line is `ROLE NAME DIGEST`. The digest is the SHA-256 of the token in hexadecimal digits, so the
file opens no page by itself. A change of the file counts at once.
"""

import hmac
import re
import secrets
import threading
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final, Literal, get_args

from schemas.errors import PermanentError
from schemas.runtime.private_file import read_private

Role = Literal["viewer", "reviewer", "operator"]
"""Roles, each of which may do what those before it may."""

ROLES: Final[tuple[Role, ...]] = get_args(Role)

TOKEN_BYTES: Final = 32
"""Random bytes of a token: no one guesses one."""

MAX_TOKEN: Final = 512
"""Characters of a token that is looked up."""

SETTING: Final = "http_tokens"

_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,63}")


@dataclass(frozen=True, slots=True)
class Person:
    """A person who asks for a page.

    Attributes:
        name: Name in the file, or as a proxy states it.
        role: What the person may do.
    """

    name: str
    role: Role

    def may(self, role: Role) -> bool:
        """Return true if this person may do what a role may."""
        return ROLES.index(self.role) >= ROLES.index(role)


def is_role(text: str) -> bool:
    """Return true for the name of a role."""
    return text in ROLES


def new_token() -> str:
    """Return a token that has never been."""
    return secrets.token_urlsafe(TOKEN_BYTES)


def token_line(name: str, role: Role, token: str) -> str:
    """Return the line of a token, without its end.

    Raises:
        PermanentError: If the name has other than letters, digits, and `._@-`.
    """
    if not _NAME.fullmatch(name):
        raise PermanentError(
            f"not a name for a token: {name!r}; it has at most 64 letters, digits, dots, dashes, "
            "underscores and @"
        )
    return f"{role} {name} {_digest(token)}"


class TokenFile:
    """Tokens of a file, read again when it changes; may be asked from any thread."""

    def __init__(self, path: Path) -> None:
        """Read the file.

        Raises:
            PermanentError: If it cannot be read, every user can read it, or a line is none.
        """
        self._path, self._lock = path, threading.Lock()
        self._state = self._stamp()
        self._people = read_tokens(path)

    def person_of(self, token: str) -> Person | None:
        """Return whose token this is; None: it is none, or the file cannot be read any more."""
        if not token or len(token) > MAX_TOKEN:
            return None
        with self._lock:
            state = self._stamp()
            if state != self._state:
                try:
                    self._people = read_tokens(self._path)
                except PermanentError:
                    self._people = {}
                self._state = state
            people = self._people
        digest = _digest(token)
        found = None
        for known, person in people.items():  # all of them, so that the time tells nothing
            if hmac.compare_digest(known, digest):
                found = person
        return found

    def _stamp(self) -> tuple[int, ...]:
        try:
            stat = self._path.stat()
        except OSError:
            return ()
        return stat.st_mtime_ns, stat.st_size, stat.st_ino, stat.st_mode


def read_tokens(path: Path) -> dict[str, Person]:
    """Read a file of tokens; return each person by the digest of the token.

    Raises:
        PermanentError: If it cannot be read, every user can read it, or a line is none.
    """
    people: dict[str, Person] = {}
    text = read_private(path, what=SETTING).decode("utf-8", "replace")
    for number, line in enumerate(text.splitlines(), start=1):
        parts = line.partition("#")[0].split()
        if not parts:
            continue
        if len(parts) != 3 or parts[0] not in ROLES or not _DIGEST.fullmatch(parts[2]):
            raise PermanentError(
                f"{SETTING}: line {number} is not ROLE NAME DIGEST; `counterpoint token` writes "
                f"such lines ({path})"
            )
        role, name, digest = parts
        people[digest] = Person(name, ROLES[ROLES.index(role)])
    return people


_DIGEST: Final = re.compile(r"[0-9a-f]{64}")


def _digest(token: str) -> str:
    return sha256(token.encode("utf-8", "replace")).hexdigest()
