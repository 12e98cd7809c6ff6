"""Routes of selections: list, show, make, and propose."""

from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, Path
from starlette.requests import Request
from starlette.responses import Response

from schemas.bounds import MAX_NAME, NO_NUL
from schemas.errors import PermanentError
from service.api.messages import ProposeRequest, SelectionsReply, SelectRequest
from service.api.reader import Reader
from service.api.routes import PREFIX
from service.curation.selection import Selection
from service.curation.strategies.catalogue import strategy_of
from service.http.context import IdempotencyKey, answer, name_by, route, source_of, turn_of
from service.http.problems import ConflictError, status_of

router = APIRouter(tags=["selections"])

NameInPath = Annotated[str, Path(min_length=1, max_length=MAX_NAME, pattern=NO_NUL)]


@route(router, "selections", summary="List selections")
def selections(request: Request) -> Response:
    """List every stored selection without its scenes, oldest first."""
    with turn_of(request) as source:
        return answer(SelectionsReply(selections=tuple(source.selections())))


@route(
    router,
    "select",
    summary="Make a selection",
    status_code=201,
    responses={200: {"model": Selection, "description": "The same selection, made before."}},
)
def select(request: Request, asked: SelectRequest, key: IdempotencyKey = None) -> Response:
    """Choose scenes by a strategy, or take the given ones, and store them under a name.

    A selection never changes. The same name again with the same choice is no error. Without a name
    the key of the request makes one, and the same key again answers with what it stored.
    """
    name = asked.name if asked.name is not None or key is None else name_by(key)
    with turn_of(request) as source:
        made = _stored(source, name, asked) if asked.name is None and name is not None else None
        status = 200 if made else 201
        if made is None:
            made = source.select(
                budget=asked.budget, name=name, scenes=asked.scenes, terms=asked.terms
            )
    at = {"location": f"{PREFIX}/selections/{quote(made.name, safe='')}"}
    return answer(made, status=status, headers=at)


@route(router, "propose", summary="Propose a selection")
def propose(request: Request, asked: ProposeRequest) -> Response:
    """Return the choice that a selection would store now, each with its reason; store nothing."""
    with turn_of(request) as source:
        return answer(source.propose(budget=asked.budget, name=asked.name, terms=asked.terms))


@route(router, "selection", summary="Show a selection")
def selection(request: Request, name: NameInPath) -> Response:
    """Return a stored selection, with the verdicts on its scenes."""
    return answer(source_of(request).selection(name))


def _stored(source: Reader, name: str, asked: SelectRequest) -> Selection | None:
    """Return what an earlier request with this key stored.

    Raises:
        ConflictError: If that was another request.
    """
    try:
        found = source.selection(name)
    except PermanentError as error:
        if status_of(error) == 404:
            return None
        raise
    strategy = strategy_of(asked.scenes, asked.terms.strategy)
    if (found.budget, found.strategy) != (asked.budget, strategy):
        raise ConflictError(
            f"this key made selection {name!r} by another request: give a new request a key of its "
            "own"
        )
    return found
