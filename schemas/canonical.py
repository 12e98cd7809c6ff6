"""Canonical JSON and its digest; equal data give equal bytes."""

import hashlib
import json
from typing import Any, Final

_CANONICAL: Final = json.JSONEncoder(
    sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
)
"""Shared encoder; `json.dumps` would make one for each message."""


def canonical_json(value: Any) -> bytes:
    """Encode plain data: sorted keys, no spaces, ASCII, NaN refused."""
    return _CANONICAL.encode(value).encode()


def sha256(payload: bytes) -> str:
    """Return the digest by which manifests, the ledger and `counterpoint top` identify a record."""
    return hashlib.sha256(payload).hexdigest()
