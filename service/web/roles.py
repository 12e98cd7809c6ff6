"""Roles on the page: which of them each form needs, and who is signed in."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from ipaddress import IPv4Network, IPv6Network, ip_address, ip_network
from pathlib import Path
from types import MappingProxyType
from typing import Final

from starlette.datastructures import Headers

from schemas.bounds import MAX_NAME
from schemas.runtime.http_guard import token_in
from schemas.runtime.tokens import ROLES, Person, Role, TokenFile
from service.api.routes import PREFIX
from service.errors import UsageError
from service.settings.config import Settings

READING: Final[Role] = "viewer"
"""Role that every page needs."""

ROLE_OF_FORM: Final[Mapping[str, Role]] = MappingProxyType(
    {
        "/theme": "viewer",
        "/reviewer": "reviewer",
        "/verdict": "reviewer",
        "/undo": "reviewer",
        "/selections": "operator",
    }
)
"""Role that each form needs; one that is not listed needs an operator."""

ANYONE: Final = "*"
"""Group of `proxy_roles` that contains every person whom a proxy signed in."""

_SAFE: Final = frozenset({"GET", "HEAD"})


def role_for(method: str, path: str) -> Role:
    """Return the role that a request needs."""
    if method in _SAFE or path.startswith(f"{PREFIX}/"):  # the API asks for more by itself
        return READING
    return ROLE_OF_FORM.get(path, "operator")


@dataclass(frozen=True, slots=True)
class Doors:
    """Ways to sign in.

    Attributes:
        tokens: Tokens that open the page.
        proxies: Networks of the proxies that are believed.
        user_header: Header of a proxy with the name.
        groups_header: Header of a proxy with the groups.
        roles: Role of each group.
    """

    tokens: TokenFile | None = None
    proxies: tuple[IPv4Network | IPv6Network, ...] = ()
    user_header: str = ""
    groups_header: str = ""
    roles: Mapping[str, Role] = field(default_factory=dict)

    @property
    def are_locked(self) -> bool:
        """True if no one gets in without credentials."""
        return self.tokens is not None or bool(self.proxies)

    def person_of(self, headers: Headers, *, peer: str) -> Person | None:
        """Return who sent a request; None: no way to sign in knows.

        Args:
            headers: Headers of the request.
            peer: Address of the other side of the connection.
        """
        token = token_in(headers.get("authorization", ""))
        if self.tokens is not None and token:
            return self.tokens.person_of(token)
        if self._is_proxy(peer):
            return self._signed_in(headers)
        return None

    def _is_proxy(self, peer: str) -> bool:
        try:
            address = ip_address(peer)
        except ValueError:
            return False
        return any(address in network for network in self.proxies)

    def _signed_in(self, headers: Headers) -> Person | None:
        names = headers.getlist(self.user_header)
        if len(names) != 1 or not (0 < len(names[0]) <= MAX_NAME and names[0].isprintable()):
            return None  # two of them: one is the person's own
        groups = {each.strip() for each in headers.get(self.groups_header, "").split(",")}
        found = [role for group, role in self.roles.items() if group in groups | {ANYONE}]
        return Person(names[0], max(found, key=ROLES.index)) if found else None


def doors_of(settings: Settings) -> Doors:
    """Return the ways to sign in to the review page.

    Raises:
        UsageError: If an address or a role is none.
        PermanentError: If the tokens cannot be read.
    """
    tokens = TokenFile(Path(settings.http_tokens)) if settings.http_tokens else None
    networks = []
    for each in settings.trusted_proxies:
        try:
            networks.append(ip_network(each, strict=False))
        except ValueError:
            raise UsageError(
                f"trusted_proxies: an address or a network such as 10.0.0.0/8, not {each!r}"
            ) from None
    roles: dict[str, Role] = {}
    for each in settings.proxy_roles:
        group, equals, said = each.rpartition("=")
        role = next((known for known in ROLES if known == said.strip()), None)
        if not (equals and group.strip() and role):
            raise UsageError(
                f"proxy_roles: group=role, with a role of {', '.join(ROLES)}, not {each!r}"
            )
        roles[group.strip()] = role
    if networks and not roles:
        raise UsageError(
            "trusted_proxies needs proxy_roles: without them no one whom a proxy signed in gets "
            "in; `*=viewer` lets all of them look"
        )
    return Doors(
        tokens,
        tuple(networks),
        settings.proxy_user_header.lower(),
        settings.proxy_groups_header.lower(),
        MappingProxyType(roles),
    )
