"""Check of stored records against their digests; damaged ones are reported, and never shown."""

import json
from collections.abc import Callable
from json.encoder import encode_basestring_ascii
from typing import Any, Final

from schemas.canonical import sha256

OnDamaged = Callable[[str, str], None]
"""Callback for a damaged record, with the id of the scene and a sentence."""

_TEXTS: Final = ("scene_id", "log_id", "state")
_NUMBERS: Final = ("start_ns", "end_ns", "score")
_COPIED: Final = frozenset((*_TEXTS, *_NUMBERS, "reasons"))


def problem_of(row: Any) -> str:
    """Compare a stored record with its digest, and with those of its columns that were read.

    Args:
        row: With `record` and `sha256`, and any of the columns that are copied from the record.

    Returns:
        A sentence on the damage; empty for an intact record.
    """
    record = bytes(row.record)
    if sha256(record) != row.sha256:
        return f"its {len(record)} bytes are not those of its digest {row.sha256}"
    if _is_found(row, record):
        return ""
    return _difference(row, json.loads(record))  # another writer's JSON need not look like ours


def _is_found(row: Any, record: bytes) -> bool:
    """Return true if the record contains each column in our encoder's form; a fast check."""
    columns = row._mapping
    for name in _COPIED & columns.keys():
        value = columns[name]
        if name == "reasons":
            written = value
        else:
            written = encode_basestring_ascii(value) if isinstance(value, str) else repr(value)
        if f'"{name}":{written},'.encode() not in record:
            return False
    return True


def _difference(row: Any, record: dict[str, Any]) -> str:
    for name in (*_TEXTS, *_NUMBERS):
        if name in row._fields and getattr(row, name) != record[name]:
            return (
                f"its {name} is stored as {getattr(row, name)!r}, the record has {record[name]!r}"
            )
    if "reasons" in row._fields and row.reasons != _as_stored(record["reasons"]):
        return "its reasons are not stored as the record has them"
    return ""


def _as_stored(reasons: Any) -> str:
    return json.dumps(reasons, separators=(",", ":"))
