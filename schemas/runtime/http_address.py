"""Addresses of HTTP pages: `HOST:PORT`, and whether other machines reach them."""

from ipaddress import ip_address


def host_of_address(listen: str) -> str:
    """Return the host of `HOST:PORT`, without brackets; empty means every address."""
    return listen.rpartition(":")[0].removeprefix("[").removesuffix("]")


def is_loopback_host(host: str) -> bool:
    """Return true for a host that only this machine reaches."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"
