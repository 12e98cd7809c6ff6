"""Endpoints of Zenoh, by text: which machine one is on, and how it is reached there."""

from collections.abc import Sequence
from ipaddress import ip_address
from typing import Final

_LOCAL_PROTOCOLS: Final = ("unixsock-stream", "unixpipe")

_EVERYWHERE: Final = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}  # noqa: S104
"""Addresses that mean every address of a machine, and the loopback of each family."""

LOCKED_PROTOCOLS: Final = ("tls", "quic")
"""Protocols that encrypt, and by which both sides can prove who they are."""


def protocol_of(endpoint: str) -> str:
    """Return the protocol of an endpoint, such as `tcp`."""
    return endpoint.partition("/")[0]


def host_of(endpoint: str) -> str:
    """Return the host of an endpoint, without port, brackets and parameters."""
    rest = endpoint.partition("/")[2]
    return rest.split("#")[0].split("?")[0].rpartition(":")[0].strip("[]")


def is_loopback(endpoint: str) -> bool:
    """Return True if an endpoint can only be on this machine.

    Args:
        endpoint: Of a router, such as `tcp/127.0.0.1:7447`.
    """
    if protocol_of(endpoint) in _LOCAL_PROTOCOLS:
        return True
    host = host_of(endpoint)
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


def from_here(endpoint: str) -> str:
    """Return the endpoint by which this machine reaches what listens on this one."""
    protocol, slash, rest = endpoint.partition("/")
    for everywhere, loopback in _EVERYWHERE.items():
        if rest.startswith(f"{everywhere}:"):
            return f"{protocol}{slash}{loopback}{rest.removeprefix(everywhere)}"
    return endpoint


def is_own(endpoint: str, listen: Sequence[str], *, machine: str) -> bool:
    """Return True if a router that listens there would connect to itself by this endpoint.

    Args:
        endpoint: One of several that all routers of a system are given.
        listen: Endpoints that this router listens on.
        machine: Name of this machine, to which a domain may be added.
    """
    ports = {_port_of(each) for each in listen}
    is_here = host_of(endpoint).partition(".")[0] == machine.partition(".")[0]
    return endpoint in listen or (is_here and _port_of(endpoint) in ports)


def _port_of(endpoint: str) -> str:
    return endpoint.split("#")[0].split("?")[0].rpartition(":")[2]
