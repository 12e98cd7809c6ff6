"""Settings of one review page: its address, its hosts, and the key of its cookies."""

import os
import secrets
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Final

import structlog

from service.errors import UsageError
from service.settings.config import cache_folder
from service.web.roles import Doors
from service.web.visitor import KEY_BYTES

KEY_NAME: Final = "review.key"

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class WebSettings:
    """Settings of one review page.

    Attributes:
        place: State folder or endpoint, as pages show it.
        key: Secret that signs the cookies of this state.
        hosts: Names under which the page may be asked, in addition to those of the loopback.
        causes: The user's own causes of failures, in addition to those of the paper.
        doors: Ways to sign in.
        rate: Requests a second of one client; 0: no limit.
        is_secure: True if the page is served by TLS, and its cookies go no other way.
    """

    place: str
    key: bytes
    hosts: frozenset[str] = frozenset()
    causes: tuple[str, ...] = ()
    doors: Doors = field(default_factory=Doors)
    rate: float = 0.0
    is_secure: bool = False


def key_of_state(folder: Path | None, *, place: str) -> bytes:
    """Return the key of a state: the same after a restart, another one for every other state.

    Args:
        folder: State folder; None: the service is elsewhere, and the key is in the cache folder.
        place: Name of the source, which names the key in the cache folder.
    """
    if folder is not None:
        with suppress(OSError):
            return _key_in(folder / KEY_NAME)
    try:
        name = sha256(place.encode()).hexdigest()[:16]
        return _key_in(cache_folder() / f"review-{name}.key")
    except (OSError, UsageError):
        log.warning("no folder for the key of the review page: forms end with this process")
        return secrets.token_bytes(KEY_BYTES)


def _key_in(path: Path) -> bytes:
    """Read the key of a file; make it first, readable by its owner alone, if there is none."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        written = path.with_name(f"{path.name}.{secrets.token_hex(6)}")
        made = os.open(written, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(made, "wb") as file:
            file.write(secrets.token_bytes(KEY_BYTES))
        with suppress(FileExistsError):  # of two that start at once, one wins
            os.link(written, path)
        written.unlink()
    key = path.read_bytes()
    if len(key) != KEY_BYTES:
        raise OSError(f"no key in {path}")
    return key
