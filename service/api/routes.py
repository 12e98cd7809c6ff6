"""Addresses of the verbs over HTTP, shared by the REST API and by the client."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

PREFIX: Final = "/api/v1"
"""Path under which the REST API lies on the address of the review page."""

IDEMPOTENCY_KEY: Final = "idempotency-key"
"""Header with the unique name of a write; the same write again is stored once."""

Access = Literal["read", "judge", "select", "operate"]
"""Permission that a verb needs: to read, to judge scenes, to make selections, to operate."""


@dataclass(frozen=True, slots=True)
class Route:
    """Method and path of one verb, below `PREFIX`; the verb's request has the names in braces.

    Attributes:
        method: A GET takes the other fields of the request as its query, a POST as its JSON body.
        path: Path with the fields of the request that are part of it in braces.
        access: Permission that it needs.
    """

    method: Literal["GET", "POST"]
    path: str
    access: Access = "read"


ROUTES: Final[Mapping[str, Route]] = MappingProxyType(
    {
        "about": Route("GET", "/about"),
        "status": Route("GET", "/status"),
        "top": Route("GET", "/ranking"),
        "scenes": Route("GET", "/scenes"),
        "overlay": Route("GET", "/scenes/{scene_id}/overlay"),
        "scene": Route("GET", "/scenes/{scene_id}"),
        "selections": Route("GET", "/selections"),
        "select": Route("POST", "/selections", "select"),
        "propose": Route("POST", "/proposals"),
        "selection": Route("GET", "/selections/{name}"),
        "modes": Route("GET", "/modes"),
        "compare": Route("POST", "/comparisons"),
        "rates": Route("GET", "/rates"),
        "activity": Route("GET", "/activity"),
        "verdicts": Route("GET", "/verdicts"),
        "judge": Route("POST", "/verdicts", "judge"),
        "undo": Route("POST", "/undos", "judge"),
        "agreement": Route("GET", "/agreement"),
        "choices": Route("GET", "/choices"),
        "retry": Route("POST", "/retries", "operate"),
        "exported": Route("POST", "/audit/exports"),
        "audit": Route("GET", "/audit", "operate"),
    }
)
"""Every verb that is answered over HTTP; workers use the others, over the bus alone."""

PAGE_ROUTES: Final[Mapping[str, Route]] = MappingProxyType(
    {
        "exports": Route("GET", "/exports"),
        "start_export": Route("POST", "/exports", "operate"),
        "stop_export": Route("POST", "/exports/{number}/stop", "operate"),
    }
)
"""Routes of what the process of the page does by itself; the bus has no such verb."""
