"""Gate of the page: who is signed in, what the role may do, and how often."""

import math
from typing import Final

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from schemas.runtime.http_guard import CHALLENGE
from schemas.runtime.stated_name import stating
from schemas.runtime.tokens import Person
from service.api.routes import PREFIX
from service.http.problems import problem
from service.web.rate_limit import WRITE_COST, RateLimit
from service.web.roles import Doors, role_for

STATIC_PATH: Final = "/static/"
"""Files that ship with the program, which probes and browsers get without credentials."""

STRANGER_COST: Final = 20.0
"""Cost of a request without valid credentials, in requests that read."""

_SAFE: Final = frozenset({"GET", "HEAD"})


class Gate:
    """ASGI middleware behind the guard: it refuses strangers, and forms above a person's role.

    The person is in `request.state.person`; the audit log of what follows has the name.
    """

    def __init__(self, app: ASGIApp, *, doors: Doors, rate: float) -> None:
        """Keep the application, the ways to sign in, and the rate, requests a second."""
        self._app, self._doors, self._limit = app, doors, RateLimit(rate)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        client = scope.get("client")
        peer = str(client[0]) if client else ""
        headers, method, path = Headers(scope=scope), scope["method"], str(scope["path"])
        person = self._doors.person_of(headers, peer=peer) if self._doors.are_locked else None
        is_open = not self._doors.are_locked or path.startswith(STATIC_PATH)
        cost = 1.0 if method in _SAFE else WRITE_COST
        if person is None and not is_open:
            cost = STRANGER_COST
        wait_s = self._limit.wait_s(person.name if person else peer, cost=cost)
        if wait_s > 0:
            response = _busy(path, wait_s)
        elif person is None and not is_open:
            response = _stranger(path)
        elif person is not None and not person.may(role_for(method, path)):
            response = _forbidden(person, method, path)
        else:
            scope.setdefault("state", {})["person"] = person
            with stating(person.name if person else ""):
                await self._app(scope, receive, send)
            return
        await response(scope, receive, send)


def _busy(path: str, wait_s: float) -> Response:
    again = {"retry-after": str(math.ceil(wait_s))}
    return _refused(path, "too many requests; ask again later", 429, again)


def _stranger(path: str) -> Response:
    challenge = {"www-authenticate": CHALLENGE}
    return _refused(path, "sign in: the password is a token, any name will do", 401, challenge)


def _forbidden(person: Person, method: str, path: str) -> Response:
    sentence = f"{person.name} is a {person.role}, and this needs a {role_for(method, path)}"
    return _refused(path, sentence, 403, {})


def _refused(path: str, sentence: str, status: int, headers: dict[str, str]) -> Response:
    """Answer with a sentence: as problem details to callers of the API, else as plain text."""
    if path.startswith(f"{PREFIX}/"):
        return problem(sentence, status=status, headers=headers)
    return PlainTextResponse(f"{sentence}\n", status, headers=headers)
