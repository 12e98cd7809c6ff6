"""Check of large JSON payloads, whose values or unknown fields could exhaust the memory.

The decoder of a message keeps an object for each value, and an error for each invalid one.
"""

import re
from collections.abc import Iterator
from functools import cache
from typing import Any, Final

from pydantic import BaseModel

from schemas.bounds import MAX_DENSE_BYTES, MAX_UNKNOWN_NAMES, MIN_BYTES_OF_A_VALUE
from schemas.errors import PermanentError

_TEXT: Final = re.compile(rb'"([^"\\]*(?:\\.[^"\\]*)*)"(\s*:)?', re.DOTALL)
"""A JSON string, and the colon that makes it a field name."""


def require_affordable(kind: type[BaseModel], payload: bytes) -> None:
    """Check the number of values and of unknown names in a payload before it is decoded.

    Args:
        kind: Expected message.
        payload: JSON, perhaps malformed, which the decoder reports.

    Raises:
        PermanentError: If its values have fewer than `MIN_BYTES_OF_A_VALUE` bytes on average, or it
            has more than `MAX_UNKNOWN_NAMES` names of fields that the message does not know.
    """
    if len(payload) <= MAX_DENSE_BYTES:
        return
    known, unknown = _names(kind), 0
    separators, end = 0, 0
    for text in _TEXT.finditer(payload):
        separators += payload.count(b",", end, text.start())
        end = text.end()
        if text[2] is not None and text[1] not in known:
            unknown += 1
            if unknown > MAX_UNKNOWN_NAMES:
                raise PermanentError(
                    f"a message of {len(payload):,} bytes has more than {MAX_UNKNOWN_NAMES} fields "
                    f"that {kind.__name__} does not have; send only those of `schemas/WIRE.md`"
                )
    separators += payload.count(b",", end)
    if separators * MIN_BYTES_OF_A_VALUE > len(payload):
        raise PermanentError(
            f"a message of {len(payload):,} bytes has {separators:,} values, more than a "
            f"{kind.__name__} of this size can have; send it in smaller ones"
        )


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
