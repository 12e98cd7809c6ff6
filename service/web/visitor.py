"""Signed cookie of a reviewer, and the token of the forms that belong to it."""

import base64
import hmac
import secrets
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import Final

from starlette.requests import Request
from starlette.responses import Response

from schemas.bounds import MAX_NAME
from service.errors import UsageError

KEY_BYTES: Final = 32

THEMES: Final = ("auto", "light", "dark")

OTHER_STATE: Final = (
    "this form belongs to another state, or to a page that was opened before this one: load the "
    "page again, then send it"
)

MAX_BUDGET: Final = 1_000_000

_A_YEAR_S: Final = 365 * 86_400


@dataclass(frozen=True, slots=True)
class Visitor:
    """One browser that reviews one state.

    Attributes:
        session: Random text that forms are bound to.
        reviewer: Name under which verdicts are stored; empty: not given yet.
        budget: Number of scenes that the reviewer wants to judge; 0: none given.
        theme: One of THEMES.
    """

    session: str
    reviewer: str = ""
    budget: int = 0
    theme: str = "auto"


class Visitors:
    """Reads and writes the cookie of one state, which the key of that state signs."""

    def __init__(self, key: bytes, *, is_secure: bool = False) -> None:
        """Keep the key of the state; a cookie that another key signed is not accepted.

        Args:
            key: The key.
            is_secure: True if browsers are to send the cookie by TLS only.
        """
        self._key, self._is_secure = key, is_secure
        self.cookie_name: Final = f"counterpoint-{self._digest('name')[:12]}"

    def of(self, request: Request) -> Visitor | None:
        """Return the visitor of a request; None without a cookie of this state."""
        value = request.cookies.get(self.cookie_name, "")
        body, _, digest = value.rpartition(".")
        if not body or not hmac.compare_digest(digest, self._digest("cookie", body)):
            return None
        session, reviewer, budget, theme = body.split(".")
        return Visitor(session, _decoded(reviewer), int(budget), theme)

    def new(self) -> Visitor:
        """Return a visitor that was never here."""
        return Visitor(secrets.token_urlsafe(18))

    def keep(self, response: Response, visitor: Visitor) -> None:
        """Set the cookie of a visitor; no page of another site can send it."""
        body = ".".join(
            (visitor.session, _encoded(visitor.reviewer), str(visitor.budget), visitor.theme)
        )
        response.set_cookie(
            self.cookie_name,
            f"{body}.{self._digest('cookie', body)}",
            max_age=_A_YEAR_S,
            httponly=True,
            secure=self._is_secure,
            samesite="strict",
        )

    def token(self, visitor: Visitor) -> str:
        """Return the token that every form of this visitor has to hold."""
        return self._digest("form", visitor.session)

    def accepts(self, visitor: Visitor | None, token: str) -> bool:
        """Return true if a form with this token is one of this visitor."""
        return visitor is not None and hmac.compare_digest(
            self.token(visitor).encode(), token.encode("utf-8", "replace")
        )

    def _digest(self, *parts: str) -> str:
        return hmac.new(self._key, "\n".join(parts).encode(), sha256).hexdigest()


def introduced(visitor: Visitor, *, name: str, budget: str) -> Visitor:
    """Return a visitor with a name and a budget as a form gave them.

    Raises:
        UsageError: If the name is empty, too long or does not print, or the budget is no count.
    """
    name, budget = name.strip(), budget.strip()
    if not (0 < len(name) <= MAX_NAME and name.isprintable()):
        raise UsageError(f"a reviewer's name has 1 to {MAX_NAME} printing characters")
    if not budget.isascii() or not (budget or "0").isdecimal() or len(budget) > 7:
        raise UsageError("a budget is a number of scenes, such as 50, or empty")
    if int(budget or "0") > MAX_BUDGET:
        raise UsageError(f"a budget has at most {MAX_BUDGET} scenes")
    return replace(visitor, reviewer=name, budget=int(budget or "0"))


def _encoded(text: str) -> str:
    return base64.urlsafe_b64encode(text.encode()).decode()


def _decoded(text: str) -> str:
    return base64.urlsafe_b64decode(text).decode()
