"""Roles and names of certificates: what a process may do on the bus, and who it is."""

import re
from typing import Final, Literal, get_args

from service.errors import UsageError

BusRole = Literal["router", "service", "worker", "reader", "operator"]
"""Roles of certificates, stored in each as its organizational unit."""

BUS_ROLES: Final[tuple[BusRole, ...]] = get_args(BusRole)

_NAME: Final = re.compile(r"[a-z0-9]([a-z0-9.-]{0,62}[a-z0-9])?")


def need_name(name: str) -> str:
    """Return a name that keys, files and certificates all accept.

    Raises:
        UsageError: If it has other than small letters, digits, dots and dashes.
    """
    if not _NAME.fullmatch(name) or ".." in name:
        raise UsageError(
            f"not a name for a certificate: {name!r}; it has at most 64 small letters, digits, "
            "dots and dashes"
        )
    return name
