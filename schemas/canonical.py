"""Canonical JSON and its digest: equal data are equal bytes."""

import hashlib
import json
from typing import Any, Final

_CANONICAL: Final = json.JSONEncoder(
    sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
)
"""Made once: `json.dumps` would make one for each message."""


def canonical_json(value: Any) -> bytes:
    """Encode plain data: sorted keys, no spaces, ASCII, NaN refused."""
    return _CANONICAL.encode(value).encode()


def sha256(payload: bytes) -> str:
    """Digest that manifests, the ledger and `counterpoint top` name a record by."""
    return hashlib.sha256(payload).hexdigest()
