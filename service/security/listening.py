"""Rule of listening: on the loopback nothing is needed, beyond it TLS and credentials are."""

from collections.abc import Sequence
from pathlib import Path

from schemas.runtime.http_address import host_of_address, is_loopback_host
from schemas.runtime.http_guard import PageGuard, tls_context
from schemas.runtime.tokens import TokenFile
from schemas.transport.bus import check_endpoints
from schemas.transport.endpoints import LOCKED_PROTOCOLS, is_loopback, protocol_of
from schemas.transport.locks import leaves, read_zenoh_config
from service.errors import UsageError
from service.settings.config import Settings

HOW_TO_LOCK = (
    "`counterpoint certs` makes certificates for tls_ca, tls_certificate and tls_key, or write "
    "insecure = true into the settings to go without"
)


def need_locked_bus(
    settings: Settings, *, listens: Sequence[str] = (), connects: Sequence[str] = ()
) -> None:
    """Refuse a router beyond the loopback that has no TLS and no credentials.

    Args:
        settings: Certificates, and Zenoh's own settings.
        listens: Endpoints that a router of this process listens on.
        connects: Endpoints of routers that this daemon joins.

    Raises:
        UsageError: If one is open, and `insecure` is not set.
    """
    check_endpoints((*listens, *connects))
    if problem := open_bus(settings, listens=listens, connects=connects):
        if settings.insecure:
            return
        raise UsageError(f"{problem}: {HOW_TO_LOCK}")


def open_bus(
    settings: Settings, *, listens: Sequence[str] = (), connects: Sequence[str] = ()
) -> str:
    """Return in one sentence which endpoint is open to all that reach it; empty: none is."""
    for endpoint in (*listens, *connects):
        if is_loopback(endpoint):
            continue
        does = "listens" if endpoint in listens else "joins a router"
        if protocol_of(endpoint) not in LOCKED_PROTOCOLS:
            return f"{endpoint} {does} beyond this machine without TLS"
        if not (settings.locks.is_set or _names_credentials(endpoint, settings)):
            return f"{endpoint} {does} beyond this machine without certificates"
    return ""


def _names_credentials(endpoint: str, settings: Settings) -> bool:
    """Return true if an endpoint, or Zenoh's own settings, demand a certificate or a password."""
    parameters = endpoint.partition("#")[2].split(";")
    if "enable_mtls=true" in parameters:
        return True
    if not settings.zenoh_config:
        return False
    laid = dict(leaves(read_zenoh_config(Path(settings.zenoh_config))))
    demands = laid.get("transport/link/tls/enable_mtls") is True
    return demands or bool(laid.get("transport/auth/usrpwd/dictionary_file"))


def has_rules(settings: Settings) -> bool:
    """Return true if Zenoh's own settings have rules of access control that are in force."""
    if not settings.zenoh_config:
        return False
    laid = dict(leaves(read_zenoh_config(Path(settings.zenoh_config))))
    return laid.get("access_control/enabled") is True


def need_locked_pages(settings: Settings, listen: str, *, setting: str) -> None:
    """Refuse pages beyond the loopback that have no TLS, or that need no credentials.

    Args:
        settings: Certificate, tokens and proxies of the pages.
        listen: Address of the pages; empty: there are none.
        setting: Name of the setting of the address, for the message.

    Raises:
        UsageError: If they are open, and `insecure` is not set.
    """
    if (problem := open_pages(settings, listen, setting=setting)) and not settings.insecure:
        raise UsageError(problem)


def open_pages(settings: Settings, listen: str, *, setting: str) -> str:
    """Return in one sentence why pages are open to all that reach them; empty: they are not."""
    if not listen or is_loopback_host(host_of_address(listen)):
        return ""
    lacks = []
    if not (settings.http_certificate and settings.http_key):
        lacks.append("TLS (http_certificate and http_key)")
    if not settings.http_tokens and not (settings.trusted_proxies and setting == "review_listen"):
        lacks.append("credentials (http_tokens; `counterpoint token` makes one)")
    if not lacks:
        return ""
    return (
        f"{setting} = {listen} is reached from other machines, and lacks {' and '.join(lacks)}: "
        "set them, listen on 127.0.0.1, or write insecure = true into the settings"
    )


def page_guard(settings: Settings) -> PageGuard:
    """Return the lock of the pages of a daemon: TLS and tokens, each if it is set.

    Raises:
        PermanentError: If a file cannot be used.
    """
    tls = None
    if settings.http_certificate or settings.http_key:
        tls = tls_context(settings.http_certificate, settings.http_key)
    return PageGuard(tls, TokenFile(Path(settings.http_tokens)) if settings.http_tokens else None)
