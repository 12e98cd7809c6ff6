"""Person of a request, whom the gate in front of page and API has found out."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from starlette.requests import Request

from schemas.runtime.tokens import Person, Role
from service.api.routes import Access

ROLE_OF: Final[Mapping[Access, Role]] = MappingProxyType(
    {"read": "viewer", "judge": "reviewer", "select": "operator", "operate": "operator"}
)
"""Role that each permission of the API needs."""


def person_of(request: Request) -> Person | None:
    """Return who is signed in; None where the page has no credentials."""
    person = getattr(request.state, "person", None)
    return person if isinstance(person, Person) else None


def admits(request: Request, access: Access) -> bool:
    """Return true if the person of a request has a permission; without credentials all have."""
    person = person_of(request)
    return person is None or person.may(ROLE_OF[access])
