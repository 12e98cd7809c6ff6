"""Terms of webhooks from the settings, and the secret that signs them."""

import base64
import binascii
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from schemas.runtime.named_file import read_named_file
from service.errors import UsageError
from service.settings.config import Settings

MIN_SECRET_BYTES: Final = 24
MAX_SECRET_BYTES: Final = 64
"""Bytes of a secret, as Standard Webhooks asks for them."""

PREFIX: Final = "whsec_"
"""Begin of a secret in the form of Standard Webhooks; it may be left out."""

_MAX_FILE_BYTES: Final = 1024


@dataclass(frozen=True, slots=True)
class WebhookTerms:
    """Terms of all deliveries.

    Attributes:
        urls: URL of each receiver.
        secret: Signs each delivery.
        events: Types of events that are sent.
        min_score: Least score of a scene that is sent.
    """

    urls: tuple[str, ...]
    secret: bytes
    events: frozenset[str]
    min_score: float

    def wants(self, event: str) -> bool:
        """Return true if there is a receiver of events of a type."""
        return bool(self.urls) and event in self.events


def webhook_terms(settings: Settings) -> WebhookTerms:
    """Return the terms that the settings state; without a URL nothing is sent.

    Raises:
        UsageError: If there is a URL and no usable secret.
    """
    return WebhookTerms(
        urls=tuple(dict.fromkeys(settings.webhooks)),
        secret=_secret(settings.webhook_secret_file) if settings.webhooks else b"",
        events=frozenset(settings.webhook_events),
        min_score=settings.webhook_min_score,
    )


def _secret(path: str) -> bytes:
    """Read the secret of a file."""
    if not path:
        raise UsageError(
            "webhooks are signed: write a secret with `openssl rand -base64 32 > FILE`, and name "
            "it in webhook_secret_file"
        )
    try:
        text = read_named_file(Path(path), at_most=_MAX_FILE_BYTES).decode().strip()
        secret = base64.b64decode(text.removeprefix(PREFIX), validate=True)
    except OSError as error:
        raise UsageError(f"webhook_secret_file: {error.strerror} ({path})") from error
    except (UnicodeDecodeError, binascii.Error):
        secret = b""
    if not MIN_SECRET_BYTES <= len(secret) <= MAX_SECRET_BYTES:
        raise UsageError(
            f"webhook_secret_file: {path} must have {MIN_SECRET_BYTES} to {MAX_SECRET_BYTES} bytes "
            "in base64, as `openssl rand -base64 32` prints them"
        )
    return secret
