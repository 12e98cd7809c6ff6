"""Check of large JSON payloads, whose values or unknown fields could exhaust the memory.

The decoder of a message keeps an object for each value, and an error for each unknown field. For a
list it keeps one error only, as long as every long list of a message stops at the first.
"""

import re
from collections.abc import Iterator
from functools import cache
from typing import Any, Final

from pydantic import BaseModel

from schemas.bounds import MAX_DENSE_BYTES, MAX_UNKNOWN_NAMES, MIN_BYTES_OF_A_VALUE

_TEXT: Final = re.compile(rb'"([^"\\]*(?:\\.[^"\\]*)*)"(\s*:)?', re.DOTALL)
"""A JSON string, and the colon that makes it a field name."""

_NAME: Final = re.compile(rb'"([^"]*)"\s*:')
"""A field name, in JSON without a backslash."""


def too_costly(kind: type[BaseModel], payload: bytes) -> str:
    """Return why a payload would cost too much memory to decode; empty: it would not.

    It would if its values have fewer than `MIN_BYTES_OF_A_VALUE` bytes on average, or if it has
    more than `MAX_UNKNOWN_NAMES` different names of fields that the message does not know.

    Args:
        kind: Expected message.
        payload: JSON, perhaps malformed, which the decoder reports.
    """
    if len(payload) <= MAX_DENSE_BYTES:
        return ""
    most = len(payload) // MIN_BYTES_OF_A_VALUE
    if payload.count(b",") > most and (separators := _separators(payload)) > most:
        return (
            f"a message of {len(payload):,} bytes has {separators:,} values, more than a "
            f"{kind.__name__} of this size can have; send it in smaller ones"
        )
    known, unknown = _names(kind), set[bytes]()
    for name in _names_in(payload):
        if name not in known:
            unknown.add(name)
            if len(unknown) > MAX_UNKNOWN_NAMES:
                return (
                    f"a message of {len(payload):,} bytes has more than {MAX_UNKNOWN_NAMES} fields "
                    f"that {kind.__name__} does not have; send only those of `schemas/WIRE.md`"
                )
    return ""


def _separators(payload: bytes) -> int:
    """Return the number of commas outside of texts."""
    count, end = 0, 0
    for text in _TEXT.finditer(payload):
        count += payload.count(b",", end, text.start())
        end = text.end()
    return count + payload.count(b",", end)


def _names_in(payload: bytes) -> Iterator[bytes]:
    if b"\\" not in payload:
        return (found[1] for found in _NAME.finditer(payload))
    return (text[1] for text in _TEXT.finditer(payload) if text[2] is not None)


@cache
def _names(kind: type[BaseModel]) -> frozenset[bytes]:
    """Return the names of all fields of a message and of the messages in it."""
    return frozenset(name.encode() for name in _properties(kind.model_json_schema()))


def _properties(schema: Any) -> Iterator[str]:
    if isinstance(schema, list):
        for each in schema:
            yield from _properties(each)
    elif isinstance(schema, dict):
        for name, below in schema.items():
            if name == "properties" and isinstance(below, dict):
                yield from below
            yield from _properties(below)
