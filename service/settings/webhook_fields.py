"""Types of the settings of webhooks: addresses of receivers, and types of events."""

from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Field

from service.curation.event_types import EVENTS
from service.settings.lock_settings import listed


def _addresses(urls: tuple[str, ...]) -> tuple[str, ...]:
    for url in urls:
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError("URLs like https://host/path")
    return urls


def _events(names: tuple[str, ...]) -> tuple[str, ...]:
    if set(names) - set(EVENTS):
        raise ValueError(f"of {', '.join(EVENTS)}")
    return names


WebhookUrls = Annotated[
    tuple[str, ...], BeforeValidator(listed), AfterValidator(_addresses), Field(max_length=10)
]
WebhookEvents = Annotated[
    tuple[str, ...], BeforeValidator(listed), AfterValidator(_events), Field(max_length=len(EVENTS))
]
