"""Notices of changed objects, as S3 stores send them: their keys, read and queued.

The form is that of AWS S3 events, which Ceph and MinIO send as well, plain or in an envelope of
Amazon SNS. A notice is a hint: each key that it names is looked up in the bucket, whatever it says.
"""

import json
from collections.abc import Iterator
from threading import Lock
from typing import Any, Final
from urllib.parse import unquote_plus, urlsplit

import structlog

from schemas.runtime.http_endpoint import HttpRequest, HttpResponse, text_response
from service.errors import UsageError

log = structlog.get_logger(__name__)

PATH: Final = "/bucket-notices"

MAX_WAITING: Final = 10_000
"""Keys that wait to be looked up; where more come, the bucket is listed: 1,000 keys a request."""

MAX_KEY: Final = 1024
"""Bytes of a key of S3."""


class BucketNotices:
    """Keys that notices named and that were not looked up yet. Methods may be called by any thread.

    Attributes:
        taken: Keys named so far.
    """

    def __init__(self, bucket_url: str) -> None:
        """Keep which bucket, and which folder of it, is watched."""
        parts = urlsplit(bucket_url)
        self._bucket = parts.netloc
        self._prefix = parts.path.strip("/") if parts.netloc else ""
        self._waiting: dict[str, None] = {}
        self._overflown = False
        self._guard = Lock()
        self.taken = 0

    def answer(self, request: HttpRequest) -> HttpResponse:
        """Take a notice of an HTTP request.

        Raises:
            UsageError: If it is none; the store keeps it, and sends it again.
        """
        keys = list(keys_of(request.body, bucket=self._bucket, prefix=self._prefix))
        with self._guard:
            self.taken += len(keys)
            self._waiting.update(dict.fromkeys(keys))
            if len(self._waiting) > MAX_WAITING:
                self._waiting, self._overflown = {}, True
        return text_response("taken")

    def drain(self) -> list[str] | None:
        """Return the keys that wait, and forget them; None: too many came, list the bucket."""
        with self._guard:
            keys, overflown = list(self._waiting), self._overflown
            self._waiting, self._overflown = {}, False
        return None if overflown else keys

    def give_back(self, keys: list[str] | None) -> None:
        """Queue keys again that could not be looked up."""
        with self._guard:
            self._overflown = self._overflown or keys is None
            self._waiting.update(dict.fromkeys(keys or ()))


def keys_of(body: bytes, *, bucket: str, prefix: str) -> Iterator[str]:
    """Yield the keys that a notice names, relative to the folder that is watched.

    Stores differ in whether they encode keys. A key that reads differently once it is decoded is
    yielded in both forms, since a key without an object changes nothing.

    Args:
        body: Body of the request.
        bucket: Name of the bucket; other buckets are ignored. Empty: any.
        prefix: Folder of the bucket that is watched, without slashes at its ends; empty: all.

    Raises:
        UsageError: If it has not the form of S3 events.
    """
    for record in _records(_parsed(body)):
        name, key = _named(record)
        if bucket and name != bucket:
            continue
        for each in dict.fromkeys((unquote_plus(key), key)):
            inside = each.removeprefix(f"{prefix}/") if prefix else each
            if inside and (not prefix or inside != each) and len(each.encode()) <= MAX_KEY:
                yield inside


_NO_EVENTS: Final = "this is no notice of S3 events: JSON with `Records` is expected"


def _parsed(body: bytes) -> dict[str, Any]:
    try:
        found = json.loads(body)
        if isinstance(found, dict) and found.get("Type") == "Notification":
            found = json.loads(str(found.get("Message")))
    except (ValueError, RecursionError):
        raise UsageError(_NO_EVENTS) from None
    if not isinstance(found, dict):
        raise UsageError(_NO_EVENTS)
    return found


def _records(found: dict[str, Any]) -> list[Any]:
    if found.get("Type") == "SubscriptionConfirmation":
        url = str(found.get("SubscribeURL"))[:2000]
        log.warning("SNS asks to confirm the subscription: open its URL", url=url)
        return []
    if found.get("Event") == "s3:TestEvent":
        return []
    records = found.get("Records")
    if not isinstance(records, list):
        raise UsageError(_NO_EVENTS)
    return records


def _named(record: Any) -> tuple[str, str]:
    try:
        name, key = record["s3"]["bucket"]["name"], record["s3"]["object"]["key"]
    except (KeyError, TypeError, IndexError):
        raise UsageError("a record of the notice names no bucket and key") from None
    if not isinstance(name, str) or not isinstance(key, str) or "\0" in key:
        raise UsageError("a record of the notice names no bucket and key")
    return name, key
