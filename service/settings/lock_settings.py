"""Settings of locks: certificates of the bus, and TLS, tokens and proxies of the pages."""

from contextlib import suppress
from typing import Annotated, Final

from pydantic import BaseModel, BeforeValidator, Field
from pydantic_core import from_json

from schemas.transport.endpoints import is_loopback
from schemas.transport.locks import Locks

HEADER_NAME: Final = r"^[A-Za-z0-9-]{1,64}$"
"""Pattern of the name of an HTTP header."""


def listed(value: object) -> object:
    """Accept `a,b`, or JSON, for a list, since a variable has no other way to write one."""
    if isinstance(value, str):
        with suppress(ValueError):  # `[ab]*` is a pattern, no JSON
            return from_json(value)
        return tuple(part.strip() for part in value.split(",") if part.strip())
    return value


Names = Annotated[tuple[str, ...], BeforeValidator(listed)]


class LockSettings(BaseModel):
    """Settings of locks; every one is a path or a rule, and none is a secret."""

    tls_ca: str = Field(
        default="",
        description="Certificate of the authority that all processes of the system share, PEM; "
        "`counterpoint certs` makes it.",
    )
    tls_certificate: str = Field(
        default="", description="Certificate of this process, PEM; its name is who it is."
    )
    tls_key: str = Field(
        default="",
        description="Private key of `tls_certificate`, PEM; refused if every user can read it.",
    )
    zenoh_config: str = Field(
        default="",
        description="File of Zenoh's own settings, JSON5, laid over ours; for `router` and `run` "
        "it has the rules that `counterpoint acl` writes.",
    )
    insecure: bool = Field(
        default=False,
        description="Listen beyond the loopback, or join a router there, without TLS and without "
        "credentials: who reaches a port may then read and write everything.",
    )
    expected_versions: Names = Field(
        default=(),
        max_length=50,
        description="Pipeline versions whose workers get leases. Empty, with a router on the "
        "loopback: any; with one beyond it: those that the ledger has, or the first of all.",
    )
    http_certificate: str = Field(
        default="",
        description="Certificate of the pages (`http_listen`, `worker_http_listen`, "
        "`review_listen`), PEM with its chain; empty: plain HTTP, on the loopback only.",
    )
    http_key: str = Field(
        default="",
        description="Private key of `http_certificate`; refused if every user can read it.",
    )
    http_tokens: str = Field(
        default="",
        description="File of tokens that `counterpoint token` writes: one line each, of role, name "
        "and digest. With it every page but `/healthz` and `/readyz` needs one.",
    )
    trusted_proxies: Names = Field(
        default=(),
        max_length=50,
        description="Addresses or networks of proxies that sign people in, and whose headers say "
        "who they are.",
    )
    proxy_user_header: str = Field(
        default="X-Forwarded-User",
        pattern=HEADER_NAME,
        description="Header of a trusted proxy with the name of the person.",
    )
    proxy_groups_header: str = Field(
        default="X-Forwarded-Groups",
        pattern=HEADER_NAME,
        description="Header of a trusted proxy with the person's groups, separated by commas.",
    )
    proxy_roles: Names = Field(
        default=(),
        max_length=100,
        description="Role of each group, as `group=viewer`, `group=reviewer` or `group=operator`; "
        "`*=viewer` is for all that a proxy signed in.",
    )
    http_rate: float = Field(
        default=100.0,
        ge=0,
        le=1e6,
        description="Requests a second that one client may send to the review page, and a tenth "
        "as many that write; ten times as many at once; 0: no limit.",
    )
    connect: str = Field(
        default="", description="Endpoint of a router, `tcp/host:port`; commas for several."
    )
    listen: str = Field(
        default="",
        description="Endpoint a router listens on; empty: a free one for `run`, "
        "tcp/127.0.0.1:7447 for `router`.",
    )

    @property
    def is_on_loopback(self) -> bool:
        """True if the router of these settings is on this machine, and serves it alone."""
        endpoints = [each for each in (*self.listen.split(","), *self.connect.split(",")) if each]
        return all(map(is_loopback, endpoints))

    @property
    def locks(self) -> Locks:
        """Certificates of this process, and Zenoh's settings laid over ours."""
        return Locks(self.tls_ca, self.tls_certificate, self.tls_key, self.zenoh_config)

    @property
    def client_locks(self) -> Locks:
        """Certificates alone: of a client in the process of a router, whose rules are not its."""
        return Locks(self.tls_ca, self.tls_certificate, self.tls_key)
